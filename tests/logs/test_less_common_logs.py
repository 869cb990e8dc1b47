"""Goals as trajectories, a bare Parquet file, encoders of other resolutions, and columns that cannot be right."""

import shutil

import numpy as np
import pytest
import robot_logs as logs

from labrun.app.logs import import_log
from labrun.errors import ModelError, RecordingError, RequestError
from labrun.logs import Stream, Wanted, column, matched, questions, read_log
from labrun.models import load_model
from labrun.store import read_recording

ZERO = 1_700_000_000 * 10**9


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM)
    return path


def write_trajectories(path, starts_s):
    """Write a bag of trajectories of three points, 0.1 s apart, one a start; the second joint is told first."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    kind = "trajectory_msgs/msg/JointTrajectory"
    time = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    with Writer(path, version=9) as writer:
        connection = writer.add_connection("/arm/joint_trajectory", kind, typestore=store)
        for number, start_s in enumerate(starts_s):
            points = [
                types["trajectory_msgs/msg/JointTrajectoryPoint"](
                    positions=np.array([-number - 0.1 * k, number + 0.1 * k]), velocities=np.array([]),
                    accelerations=np.array([]), effort=np.array([]),
                    time_from_start=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=k * 10**8),
                )
                for k in range(3)
            ]  # fmt: skip
            message = types[kind](
                header=types["std_msgs/msg/Header"](stamp=time, frame_id=""), joint_names=["elbow", "shoulder"],
                points=points,
            )  # fmt: skip
            writer.write(connection, ZERO + round(start_s * 1e9), store.serialize_cdr(message, kind))
    return path


def test_a_trajectory_is_told_point_by_point_until_the_next_one_comes(tmp_path):
    pytest.importorskip("rosbags")
    (stream,) = read_log(write_trajectories(tmp_path / "bag", [0.0, 0.15, 2.0]), None)
    assert stream.time_s == pytest.approx([0.0, 0.1, 0.15, 0.25, 0.35, 2.0, 2.1, 2.2])
    shoulder = next(other for other in stream.columns if other.stem == "shoulder")
    assert shoulder.role == "command"
    assert shoulder.values == pytest.approx([0, 0.1, 1.0, 1.1, 1.2, 2.0, 2.1, 2.2])


def test_a_bare_parquet_file_is_read(tmp_path, arm):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    time_s, goals, angles = logs.motion()
    columns = dict(
        zip(("shoulder_pos", "elbow_pos", "shoulder_cmd", "elbow_cmd"), [*angles.T, *goals.T], strict=True)
    )
    parquet.write_table(pyarrow.table({"time_s": time_s, **columns}), tmp_path / "log.parquet")
    recording = read_recording(import_log(tmp_path / "log.parquet", arm, tmp_path / "recording").folder)
    assert len(recording.trials) == 3
    lowest = min(trial.inputs[:, 1].min() for trial in recording.trials)
    assert lowest == pytest.approx(goals[:, 1].min(), abs=1e-6)


def test_a_joint_at_rest_behind_a_coarse_encoder_is_not_frozen_but_one_that_jumps_is(tmp_path, arm):
    time_s, goals, angles = logs.motion(moves=3)
    goals, angles = np.round(goals * 651.9 + 2048), np.round(angles * 651.9 + 2048)
    plain = import_log(logs.write_csv(tmp_path / "a.csv", time_s, goals, angles), arm, tmp_path / "one")
    assert not [text for text in plain.remarks if "frozen" in text or "end of its range" in text]
    angles[165:205, 0] = angles[165, 0]
    stuck = import_log(logs.write_csv(tmp_path / "b.csv", time_s, goals, angles), arm, tmp_path / "two")
    assert [text for text in stuck.remarks if "shoulder is frozen" in text] == [
        "left out 1.650 to 2.040 s: shoulder is frozen"
    ]


def test_a_unit_that_takes_a_joint_far_out_of_its_range_is_refused_and_a_wrong_zero_is_told(tmp_path, arm):
    time_s, goals, angles = logs.motion(moves=2)
    log = logs.write_csv(tmp_path / "deg.csv", time_s, np.rad2deg(goals), np.rad2deg(angles))
    with pytest.raises(
        RequestError, match=r"shoulder is measured from .* rad, and its range in the model is -2 to 2"
    ):
        import_log(log, arm, tmp_path / "one", unit="rad")
    assert not (tmp_path / "one").exists()
    log = logs.write_csv(tmp_path / "zero.csv", time_s, goals, angles + 2.0)
    made = import_log(log, arm, tmp_path / "two")
    assert any("shoulder is measured" in remark and "the zero" in remark for remark in made.remarks)


def test_a_joint_that_friction_holds_still_is_not_frozen(tmp_path, arm):
    time_s, goals, angles = logs.motion(moves=3)
    held, still = angles.copy(), time_s % 4.0 > 3.2
    for row in range(1, len(held)):
        if still[row] or row % 10 == 0:
            held[row] = held[row - 1]
    made = import_log(logs.write_csv(tmp_path / "a.csv", time_s, goals, held), arm, tmp_path / "one")
    assert not [text for text in made.remarks if "frozen" in text or "end of its range" in text]


def test_a_table_with_semicolons_and_decimal_commas_is_the_same_table(tmp_path, arm):
    made = logs.motion(moves=2)
    first = logs.write_csv(tmp_path / "a.csv", *made)
    second = tmp_path / "b.csv"
    second.write_text(first.read_text().replace(",", ";").replace(".", ","))
    first_made, second_made = (import_log(path, arm, tmp_path / path.stem) for path in (first, second))
    assert (first_made.folder / "001.csv").read_text() == (second_made.folder / "001.csv").read_text()


def test_nameless_goals_are_mapped_by_joint_and_all_proposals_can_be_copied(tmp_path, arm):
    time_s, goals, angles = logs.motion(moves=2)
    names = ["time_s", "cmd_1", "cmd_2", "shoulder", "elbow"]
    log = logs.write_csv(tmp_path / "a.csv", time_s, goals, angles, names)
    with pytest.raises(RequestError) as error:
        import_log(log, arm, tmp_path / "one")
    assert error.value.hint.endswith(
        "if all proposals are right: --map shoulder_command=cmd_1 --map elbow_command=cmd_2"
    )
    made = import_log(log, arm, tmp_path / "one", mapping=["shoulder=cmd_1", "elbow=cmd_2"])
    assert dict(made.channels)["shoulder"] == "shoulder"
    assert dict(made.channels)["shoulder_command"] == "cmd_1"


def test_trials_cut_too_short_are_said_to_be(tmp_path, arm):
    log = logs.write_csv(tmp_path / "a.csv", *logs.motion(moves=2))
    with pytest.raises(RecordingError, match=r"no trial would be 0\.5 s and 20 samples long"):
        import_log(log, arm, tmp_path / "one", cut_s=0.1)


def test_one_column_is_not_two_channels(tmp_path, arm):
    log = logs.write_csv(tmp_path / "log.csv", *logs.motion())
    with pytest.raises(
        RequestError, match="shoulder and elbow: column shoulder_pos was taken for all of them"
    ):
        import_log(log, arm, tmp_path / "recording", mapping=["elbow=shoulder_pos"])
    assert not (tmp_path / "recording").exists()


@pytest.mark.parametrize(("message", "measured"), [("cmd_", "enc_"), ("goal_j", "state_j")])
def test_numbered_columns_are_proposed_by_their_number(tmp_path, arm, message, measured):
    names = ["time_s", f"{message}1", f"{message}2", f"{measured}1", f"{measured}2"]
    log = logs.write_csv(tmp_path / "log.csv", *logs.motion(), names=names)
    with pytest.raises(RequestError) as asked:
        import_log(log, arm, tmp_path / "recording")
    proposals = [line.partition("proposal: --map ")[2] for line in str(asked.value).splitlines()]
    proposals = [proposal for proposal in proposals if proposal]
    assert proposals == [
        f"shoulder_command={message}1", f"elbow_command={message}2", f"shoulder={measured}1", f"elbow={measured}2",
    ]  # fmt: skip
    assert import_log(log, arm, tmp_path / "recording", mapping=proposals).trials == 3


def test_stamps_of_an_hdf5_group_are_those_of_the_nearest_group_around_it(tmp_path, arm):
    h5py = pytest.importorskip("h5py")
    time_s, goals, angles = logs.motion()
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["robot/timestamp"] = time_s
        for index, joint in enumerate(logs.JOINTS):
            file[f"robot/command/{joint}"] = goals[:, index]
            file[f"state/{joint}"] = angles[:, index]  # beside the stamps, and as many
    made = import_log(tmp_path / "log.h5", arm, tmp_path / "recording")
    assert dict(made.channels)["elbow_command"] == "robot/command/elbow"
    assert dict(made.channels)["elbow"] == "state/elbow"
    assert "state/elbow, state/shoulder have no stamps of their own" in " ".join(made.remarks)


def test_of_two_topics_of_positions_the_one_that_tells_more_is_proposed_as_measured():
    still = np.zeros(50)
    wanted = [
        Wanted("elbow_command", "rad", "input", ("elbow",), ("command",)),
        Wanted("elbow", "rad", "output", ("elbow",), ("position",)),
    ]
    leader = Stream("/leader", still, (column("/leader/position", "elbow", still),))
    parts = ("position", "velocity", "effort")
    follower = Stream(
        "/follower", still, tuple(column(f"/follower/{part}", "elbow", still) for part in parts)
    )
    asked = [question.proposal for question in questions(matched(wanted, [leader, follower], {})[1])]
    assert asked == ["--map elbow_command=/leader/position/elbow", "--map elbow=/follower/position/elbow"]


def test_a_column_that_is_another_joints_is_not_proposed():
    still = np.zeros(50)
    names = ("elbow_yaw", "elbow_roll")
    wanted = [Wanted(name, "rad", "output", (name,), ("position",)) for name in names]
    log = Stream("log", still, (column("", "elbow_roll_pos", still), column("", "elbow_jaw_pos", still)))
    (question,) = questions(matched(wanted, [log], {})[1])
    assert question.proposal == "--map elbow_yaw=elbow_jaw_pos"


def test_the_only_goal_and_angle_of_a_log_are_proposed_for_the_only_joint(tmp_path):
    robot = tmp_path / "pan.xml"
    robot.write_text(
        '<mujoco><worldbody><body><joint name="pan"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
        '</worldbody><actuator><position name="pan" joint="pan" kp="9"/></actuator></mujoco>'
    )
    time_s, goals, angles = logs.motion()
    names = ["time_s", "goal", "angle"]
    log = logs.write_csv(tmp_path / "log.csv", time_s, goals[:, :1], angles[:, :1], names=names)
    with pytest.raises(RequestError) as asked:
        import_log(log, robot, tmp_path / "recording")
    assert "if all proposals are right: --map pan_command=goal --map pan=angle" in str(asked.value.hint)


def test_ticks_of_another_encoder_are_counted_as_said(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    counts = [np.round(angle * 16384 / (2 * np.pi) + 8192) for angle in (goals, angles)]
    log = logs.write_csv(tmp_path / "log.csv", time_s, *counts)
    with pytest.raises(RequestError, match=r"more than 4096 ticks of a turn(.|\n)*ticks:16384"):
        import_log(log, arm, tmp_path / "recording")
    made = import_log(log, arm, tmp_path / "recording", unit="ticks:16384")
    assert any(text.startswith("goals are in ticks of 16384 a turn") for text in made.remarks)
    highest = max(trial.inputs[:, 0].max() for trial in read_recording(made.folder).trials)
    assert highest == pytest.approx(goals[:, 0].max(), abs=4e-4)
    with pytest.raises(RequestError, match="no unit of angles"):
        import_log(log, arm, tmp_path / "other", unit="ticks:many")


def test_a_log_of_two_rows_is_told_to_be_short(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    log = logs.write_csv(tmp_path / "log.csv", time_s[:2], goals[:2], angles[:2])
    with pytest.raises(
        RecordingError, match="log has 2 samples with a stamp of their own; at least 20 are needed"
    ):
        import_log(log, arm, tmp_path / "recording")


def test_one_trial_and_one_gap_are_one(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    late = np.where(time_s > 6.2, time_s + 1.0, time_s)
    log = logs.write_csv(tmp_path / "log.csv", late, goals, angles)
    assert any("1 gap of more than" in remark for remark in import_log(log, arm, tmp_path / "a").remarks)
    log = logs.write_csv(tmp_path / "short.csv", time_s[:400], goals[:400], angles[:400])
    assert import_log(log, arm, tmp_path / "b").to_text().startswith("1 trial, ")


def test_a_python_file_as_model_is_told_what_to_name(tmp_path):
    file = tmp_path / "mk.py"
    file.write_text("MODEL = None\n")
    with pytest.raises(ModelError, match=r"--model mk:MODEL"):
        load_model(file)


def test_a_lerobot_folder_whose_data_are_missing_is_refused_and_its_meta_is_no_log(tmp_path):
    pytest.importorskip("pyarrow")
    _, goals, angles = logs.motion()
    folder = logs.write_lerobot(tmp_path / "set", goals, angles, version=3)
    shutil.rmtree(folder / "data")
    with pytest.raises(RecordingError, match=r"holds no \.parquet file"):
        read_log(folder)
