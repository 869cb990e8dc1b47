"""Every kind of log gives the recording of what happened; what is unclear is asked for, what is bad is left out."""

import numpy as np
import pytest
import robot_logs as logs
from hypothesis import given
from hypothesis import strategies as st

from labrun.app.logs import import_log
from labrun.errors import RecordingError, RequestError
from labrun.logs import Match, Stream, Wanted, column, statements, table_of
from labrun.models import load_model
from labrun.store import read_recording


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM)
    return path


def columns(recording, name):
    """Return a channel of all trials, one after another."""
    names = [signal.name for signal in (*recording.inputs, *recording.outputs)]
    tables = [np.column_stack([trial.inputs, trial.outputs]) for trial in recording.trials]
    return np.concatenate(tables)[:, names.index(name)]


WRITERS = {
    "csv": lambda folder, *made: logs.write_csv(folder / "log.csv", *made),
    "npz": lambda folder, *made: logs.write_npz(folder / "log.npz", *made),
    "lerobot": lambda folder, *made: logs.write_lerobot(folder / "set", made[1], made[2]),
    "lerobot3": lambda folder, *made: logs.write_lerobot(folder / "set", made[1], made[2], version=3),
    "rosbag2": lambda folder, *made: logs.write_bag(folder / "bag", *made),
    "mcap": lambda folder, *made: next(logs.write_bag(folder / "bag", *made).glob("*.mcap")),
    "db3": lambda folder, *made: next(logs.write_bag(folder / "bag", *made, storage="sqlite").glob("*.db3")),
    "ros1": lambda folder, *made: logs.write_bag(folder / "log.bag", *made, storage="ros1"),
}
NEEDS = {
    **dict.fromkeys(("lerobot", "lerobot3"), "pyarrow"),
    **dict.fromkeys(("rosbag2", "mcap", "db3", "ros1"), "rosbags"),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_of_log_gives_the_recording_of_what_happened(tmp_path, arm, kind):
    if kind in NEEDS:
        pytest.importorskip(NEEDS[kind])
    _, goals, angles = made = logs.motion()
    folder = import_log(WRITERS[kind](tmp_path, *made), arm, tmp_path / "recording").folder
    recording = read_recording(folder)
    assert len(recording.trials) == 3
    assert len({trial.condition["motion"] for trial in recording.trials}) == 1, "the same goals are repeats"
    if NEEDS.get(kind) == "rosbags":  # goals have a topic of their own, half a period before what is measured
        goals = (goals + np.vstack([goals[1:], goals[-1:]])) / 2
    happened = np.column_stack([goals, angles])
    for trial in recording.trials:
        measured = np.column_stack([trial.inputs, trial.outputs])
        first = int(np.argmin(np.abs(happened[:, None] - measured[0]).sum(axis=(1, 2))))
        assert len(measured) > 300
        assert measured == pytest.approx(happened[first : first + len(measured)], abs=1e-6)
    model = load_model(folder / "model.toml")
    assert [signal.between for signal in model.inputs] == ["hold", "hold"]
    assert model.initial["shoulder_rate"] == 0.0


def test_an_hdf5_log_is_asked_about_what_has_no_name(tmp_path, arm):
    _, goals, _ = made = logs.motion()
    log = logs.write_h5(tmp_path / "log.h5", *made)
    with pytest.raises(RequestError) as asked:
        import_log(log, arm, tmp_path / "recording")
    assert "proposal: --map shoulder_command=action[0]" in str(asked.value)
    assert not (tmp_path / "recording").exists()
    answers = ["shoulder_command=action[0]", "elbow_command=action[1]"]
    recording = read_recording(import_log(log, arm, tmp_path / "recording", mapping=answers).folder)
    assert columns(recording, "elbow_command").min() == pytest.approx(goals[:, 1].min(), abs=1e-6)


def test_joints_of_other_names_are_proposed_and_mapped_with_what_they_are_told(tmp_path, arm):
    made = logs.motion()
    log = logs.write_csv(
        tmp_path / "log.csv", *made, names=["t", "shoulder_1_cmd", "elbow_cmd", "shoulder_1_pos", "elbow_pos"]
    )
    with pytest.raises(RequestError, match="proposal: --map shoulder=shoulder_1_pos"):
        import_log(log, arm, tmp_path / "recording")
    made = import_log(log, arm, tmp_path / "recording", mapping=["shoulder=shoulder_1"])
    assert dict(made.channels)["shoulder_command"] == "shoulder_1_cmd"


def test_a_log_that_is_not_there_is_told_with_the_one_that_is_called_alike(tmp_path, arm):
    log = logs.write_csv(tmp_path / "log.csv", *logs.motion())
    with pytest.raises(RequestError, match=r"cannot find the log .*lgo\.csv") as refused:
        import_log(tmp_path / "lgo.csv", arm, tmp_path / "recording")
    assert str(log) in str(refused.value.hint)


def test_a_column_that_is_there_is_never_called_missing(tmp_path, arm):
    """Mapped to a whole joint, it is what was measured of it; its goal is asked for with the flag that says it."""
    log = logs.write_csv(tmp_path / "log.csv", *logs.motion(), names=["t", "u1", "u2", "m1", "m2"])
    with pytest.raises(RequestError) as refused:
        import_log(log, arm, tmp_path / "recording", mapping=["shoulder=m1", "elbow=m9"])
    message = str(refused.value)
    assert "--map says m1, which is not read as what is told; --map shoulder_command=COLUMN" in message
    assert "--map says m9, and the log has no such column" in message
    assert "m1, and the log has no such column" not in message


def test_two_columns_that_both_could_be_it_are_both_named(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    names = ["t", "shoulder_cmd", "elbow_cmd", "shoulder_pos", "elbow_pos", "shoulder_actual"]
    log = logs.write_csv(tmp_path / "log.csv", time_s, goals, np.column_stack([angles, angles[:, 0]]), names)
    with pytest.raises(RequestError, match="shoulder_pos, shoulder_actual"):
        import_log(log, arm, tmp_path / "recording")


def test_what_the_log_does_not_have_can_be_left_out(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    names = ["t", "shoulder_cmd", "elbow_cmd", "shoulder_pos"]
    log = logs.write_csv(tmp_path / "log.csv", time_s, goals, angles[:, :1], names)
    folder = import_log(
        log, arm, tmp_path / "recording", mapping=["elbow=none", "elbow_command=elbow_cmd"]
    ).folder
    assert [output.name for output in load_model(folder / "model.toml").outputs] == ["shoulder"]


@pytest.mark.parametrize(
    ("scale", "offset", "message"),
    [(180 / np.pi, 0.0, "degrees"), (4096 / (2 * np.pi), 2048.0, "ticks of 4096 a turn")],
)
def test_units_are_told_from_the_range_and_said(tmp_path, arm, scale, offset, message):
    time_s, goals, angles = logs.motion()
    rounded = np.round if "ticks" in message else np.asarray
    log = logs.write_csv(
        tmp_path / "log.csv", time_s, rounded(scale * goals + offset), rounded(scale * angles + offset)
    )
    made = import_log(log, arm, tmp_path / "recording")
    assert f"measured angles are in {message}" in " ".join(made.remarks)
    assert columns(read_recording(made.folder), "shoulder").max() == pytest.approx(
        angles[:, 0].max(), abs=1e-3
    )


def test_goals_in_degrees_beside_angles_that_look_like_radians_are_asked_for(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    log = logs.write_csv(
        tmp_path / "log.csv", time_s, 60 * goals, 6 * angles
    )  # a blocked arm moves a few degrees
    with pytest.raises(RequestError, match="look like radians and goals look like degrees") as error:
        import_log(log, arm, tmp_path / "recording")
    assert "--unit deg" in str(error.value.hint)
    assert not (tmp_path / "recording").exists()


def test_a_range_that_could_be_degrees_or_shares_is_asked_for(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    full = np.abs(angles).max()
    log = logs.write_csv(tmp_path / "log.csv", time_s, 100 / full * goals, 100 / full * angles)
    with pytest.raises(RequestError, match="degrees, or shares of the range"):
        import_log(log, arm, tmp_path / "recording")
    folder = import_log(log, arm, tmp_path / "recording", unit="normalised").folder
    assert np.abs(columns(read_recording(folder), "shoulder")).max() == pytest.approx(
        2.0, rel=1e-6
    )  # all of its range


def test_shares_of_the_range_in_a_lerobot_dataset_are_asked_for_however_small_and_told_elsewhere(
    tmp_path, arm
):
    pytest.importorskip("pyarrow")
    time_s, goals, angles = logs.motion()
    scale = 39 / np.abs(angles).max()
    dataset = logs.write_lerobot(tmp_path / "set", goals, angles, scale=scale)
    with pytest.raises(RequestError, match="LeRobot data set, which does not say its unit") as asked:
        import_log(dataset, arm, tmp_path / "recording")
    assert "--unit deg or --unit normalised" in str(asked.value)
    assert not (tmp_path / "recording").exists()
    recording = read_recording(import_log(dataset, arm, tmp_path / "one", unit="normalised").folder)
    assert np.abs(columns(recording, "shoulder")).max() == pytest.approx(
        0.39 * 2.0, rel=1e-6
    )  # range -2 to 2
    small = import_log(logs.write_lerobot(tmp_path / "small", goals, angles), arm, tmp_path / "two")
    assert "radians, by their range" in " ".join(small.remarks)
    assert "--unit deg or normalised if it is that" in " ".join(small.remarks)
    log = logs.write_csv(tmp_path / "log.csv", time_s, scale * goals, scale * angles)
    made = import_log(log, arm, tmp_path / "other")
    assert "--unit normalised if they are" in " ".join(made.remarks)


def test_a_robot_whose_clock_is_another_is_shifted_to_the_recorders(tmp_path, arm):
    pytest.importorskip("rosbags")
    made = import_log(
        logs.write_bag(tmp_path / "bag", *logs.motion(), clock_s=-3600.0, named_goals=False),
        arm, tmp_path / "recording", mapping=["shoulder_command=/goal_command[0]", "elbow_command=/goal_command[1]"],
    )  # fmt: skip
    assert "+3600.00" in " ".join(made.remarks)
    assert made.duration_s > 9


@pytest.mark.parametrize(("clock_s", "message"), [(-0.02, "lie 22.0 ms before their receipt"), (0.0, "")])
def test_a_topic_that_is_stamped_early_is_told(tmp_path, arm, clock_s, message):
    pytest.importorskip("rosbags")
    bag = logs.write_bag(tmp_path / "bag", *logs.motion(), clock_s=clock_s, named_goals=False)
    goals = ["shoulder_command=/goal_command[0]", "elbow_command=/goal_command[1]"]
    made = import_log(bag, arm, tmp_path / "recording", mapping=goals)
    text = " ".join(remark for remark in made.remarks if "before their receipt" in remark)
    assert message in text
    assert bool(message) == bool(text)


def test_stamps_are_repaired_by_the_rule_or_refused(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    twice = time_s.copy()
    twice[[50, 500]] = twice[[49, 499]]
    made = import_log(logs.write_csv(tmp_path / "a.csv", twice, goals, angles), arm, tmp_path / "one")
    assert "2 samples whose stamps repeat or run backwards are left out" in " ".join(made.remarks)
    shuffled = time_s.copy()
    shuffled[100:600:2] -= 0.05
    with pytest.raises(RecordingError, match="stamps repeat or run backwards, more than 5%"):
        import_log(logs.write_csv(tmp_path / "b.csv", shuffled, goals, angles), arm, tmp_path / "two")


@pytest.mark.parametrize("received", [True, False])
def test_stamps_of_receipt_that_scatter_become_even_and_stamps_of_measurement_stay(received):
    rng = np.random.default_rng(2)
    true_s = np.arange(0.0, 5.0, 0.01)
    late_s = np.sort(true_s + rng.uniform(0.0, 0.012, len(true_s)))
    angle = column("", "shoulder_pos", np.sin(true_s))
    wanted = Wanted("shoulder", "rad", "output", ("shoulder",), ("position",))
    stream = Stream("joints", late_s, (angle,), received=received)
    table, findings = table_of([Match(wanted, stream, angle)])
    assert ("are replaced by even ones" in " ".join(statements(findings))) == received
    expected = np.diff(np.linspace(late_s[0], late_s[-1], len(late_s)) if received else late_s)
    assert np.diff(table.time_s) == pytest.approx(expected, abs=1e-9)


def told_beside(told_s, goals, at):
    """Return the table of a joint whose goals have a topic of their own."""
    goal, angle = column("", "joint_cmd", goals), column("", "joint_pos", np.sin(at))
    matches = [
        Match(
            Wanted("joint_command", "rad", "input", ("joint",), ("command",)),
            Stream("goals", told_s, (goal,)),
            goal,
        ),
        Match(
            Wanted("joint", "rad", "output", ("joint",), ("position",)), Stream("joints", at, (angle,)), angle
        ),
    ]
    return table_of(matches)[0]


@given(rate_hz=st.floats(5.0, 1000.0), phase=st.floats(0.0, 1.0), seed=st.integers(0, 2**32 - 1))
def test_a_goal_of_another_topic_comes_neither_early_nor_late(rate_hz, phase, seed):
    """A servo's push up to any sample is that of the goals as they stood, whatever the phase of the two topics."""
    rng = np.random.default_rng(seed)
    told_s = np.arange(0.0, 3.0, 1 / rate_hz)
    goals = np.round(rng.standard_normal(len(told_s)), 1)
    at = np.arange(0.5, 2.5, 0.02) + phase * 0.02
    table = told_beside(told_s, goals, at)
    edges = np.append(told_s, 3.0)
    pushed = np.interp(at, edges, np.append(0.0, np.cumsum(goals * np.diff(edges))))
    recorded = np.append(0.0, np.cumsum(table.values[:-1, 0] * np.diff(at)))
    assert recorded == pytest.approx(pushed - pushed[0], abs=1e-9)


def test_a_goal_that_is_told_again_and_again_stays_exactly_what_it_is():
    at, told_s = np.arange(0.5, 2.5, 0.02), np.arange(0.0, 3.0, 0.0031)
    table = told_beside(told_s, np.full(len(told_s), 0.1), at)
    assert set(table.values[:, 0]) == {0.1}


def test_the_log_is_cut_at_a_drop_out(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    kept = (time_s < 6.0) | (time_s > 6.5)
    made = import_log(
        logs.write_csv(tmp_path / "a.csv", time_s[kept], goals[kept], angles[kept]), arm, tmp_path / "one"
    )
    assert "1 gap of more than 5 periods, the longest 0.52 s" in " ".join(made.remarks)
    for trial in read_recording(made.folder).trials:
        assert np.diff(trial.time_s).max() < 0.05


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda angles: np.where(np.arange(len(angles)) // 100 == 6, angles[600], angles),
            "shoulder is frozen",
        ),
        (lambda angles: np.minimum(angles, 0.6), "shoulder stands at the end of its range"),
        (
            lambda angles: angles + 0.4 * np.exp(-((np.arange(len(angles)) - 1550) ** 2) / 300),
            "shoulder moves while nothing is commanded",
        ),
    ],
)
def test_what_cannot_be_trusted_is_left_out_and_said(tmp_path, arm, spoil, message):
    time_s, goals, angles = logs.motion(moves=3)
    still = np.arange(12, 18, 1 / logs.RATE_HZ)
    rng = np.random.default_rng(5)
    time_s = np.append(time_s, still)
    goals = np.vstack([goals, np.zeros((len(still), 2))])
    angles = np.vstack([angles, 1e-3 * rng.standard_normal((len(still), 2))])
    angles[:, 0] = spoil(angles[:, 0])
    made = import_log(logs.write_csv(tmp_path / "a.csv", time_s, goals, angles), arm, tmp_path / "one")
    assert message in " ".join(made.remarks)
    assert made.duration_s < time_s[-1] - 0.2


@pytest.mark.parametrize(("seconds", "trials"), [(2.5, 5), (3.5, 4)])
def test_a_log_is_cut_as_asked(tmp_path, arm, seconds, trials):
    log = logs.write_csv(tmp_path / "a.csv", *logs.motion())
    made = import_log(log, arm, tmp_path / "one", cut_s=seconds)
    assert made.trials == trials
    assert load_model(made.folder / "model.toml").initial["shoulder_rate"] == "free"


def test_a_joint_that_never_moves_hides_no_rest_of_the_others(tmp_path, arm):
    time_s, goals, angles = logs.motion()
    goals[:, 1], angles[:, 1] = 0.0, 1e-3 * np.random.default_rng(2).standard_normal(len(time_s))
    made = import_log(logs.write_csv(tmp_path / "a.csv", time_s, goals, angles), arm, tmp_path / "one")
    assert made.trials == 3
    assert "cut at rests of 0.5 s and more" in made.remarks


def test_a_long_log_with_one_rest_only_is_cut_all_the_same(tmp_path, arm):
    rng = np.random.default_rng(4)
    time_s = np.arange(0, 40, 1 / logs.RATE_HZ)
    moving = 0.5 * np.sin(np.pi * np.maximum(time_s - 0.8, 0.0)) + 0.3 * np.clip(1 - 10 * time_s, 0, 1)
    angles = np.column_stack([moving, -moving]) + 1e-3 * rng.standard_normal((len(time_s), 2))
    goals = np.column_stack([moving, -moving]) + 1e-4 * rng.standard_normal(
        (len(time_s), 2)
    )  # as a leader arm's
    made = import_log(logs.write_csv(tmp_path / "a.csv", time_s, goals, angles), arm, tmp_path / "one")
    assert made.trials == 4
    assert "cut every 10 s, as it has no rests" in made.remarks


def test_a_robot_without_a_hinge_or_slide_is_told(tmp_path):
    ball = tmp_path / "ball.xml"
    ball.write_text(
        '<mujoco><worldbody><body><joint type="free"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(RecordingError, match="no hinge or slide"):
        import_log(logs.write_csv(tmp_path / "a.csv", *logs.motion()), ball, tmp_path / "one")


URDF = (
    '<robot name="arm"><link name="base"/><link name="upper"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>'
    '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="2" effort="10" velocity="3"/></joint></robot>'
)


def test_a_urdf_gets_the_drive_that_the_log_tells(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(URDF)
    time_s, goals, angles = logs.motion()
    for name, unit in (("shoulder_cmd", "rad"), ("shoulder_effort", "N m")):
        log = logs.write_csv(
            tmp_path / "a.csv", time_s, goals[:, :1], angles[:, :1], ["t", name, "shoulder_pos"]
        )
        made = import_log(log, urdf, tmp_path / name)
        assert [signal.unit for signal in load_model(made.folder / "model.toml").inputs] == [unit]
        assert "the file has no actuator there" in " ".join(made.remarks)


def test_goals_that_no_joint_of_a_urdf_takes_are_told_with_what_makes_a_servo_of_them(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(URDF)
    time_s, goals, angles = logs.motion()
    log = logs.write_npz(tmp_path / "a.npz", time_s, goals[:, :1], angles[:, :1])
    message = " ".join(import_log(log, urdf, tmp_path / "still").remarks)
    assert "ctrl[0] is not used" in message
    assert "--map shoulder_command=ctrl[0]" in message
    made = import_log(log, urdf, tmp_path / "driven", mapping=["shoulder_command=ctrl[0]"])
    assert dict(made.channels)["shoulder_command"] == "ctrl[0]"
    assert "is not used" not in " ".join(made.remarks)


def test_a_model_of_equations_is_matched_as_well(tmp_path):
    model = tmp_path / "follower.toml"
    model.write_text(
        'name = "follower"\nstates = ["angle"]\n[inputs]\ngoal = { unit = "rad" }\n[parameters]\n'
        'lag = { value = 0.1, unit = "s" }\n[equations]\nangle = "(goal - angle) / lag"\n'
        '[outputs]\nangle = { equation = "angle", unit = "rad" }\n'
    )
    time_s, goals, angles = logs.motion()
    log = logs.write_csv(tmp_path / "a.csv", time_s, goals[:, :1], angles[:, :1], ["t", "goal", "angle"])
    folder = import_log(log, model, tmp_path / "one").folder
    assert load_model(folder / "model.toml").outputs[0].name == "angle"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "t,x\n", "no sample below"),
        ("a.csv", "", "the file is empty"),
        ("a.csv", "hello there\nnothing\n", "no column holds numbers"),
        ("a.csv", "x,y\n1,2\n3,4\n", "no column of time"),
        ("a.csv", "t,x\n1,2\n3\n4,5\n", "a.csv:3: 1 cells below a header of 2"),
        ("a.bag", "nonsense", "cannot be read as a bag"),
        ("a.npz", "nonsense", "is no whole NumPy archive"),
        ("a.npz", "", "is no whole NumPy archive"),
        ("a.h5", "nonsense", "cannot be read"),
        ("a.parquet", "nonsense", "cannot be read"),
        ("a.xyz", "nonsense", "is no log that labrun reads"),
    ],
)
def test_a_file_that_is_no_log_is_told(tmp_path, arm, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises((RequestError, RecordingError)) as error:
        import_log(tmp_path / name, arm, tmp_path / "one")
    assert message in str(error.value)


def test_an_archive_that_was_cut_short_is_told(tmp_path, arm):
    log = logs.write_npz(tmp_path / "a.npz", *logs.motion())
    log.write_bytes(log.read_bytes()[:-200])
    with pytest.raises(RecordingError, match="no whole NumPy archive"):
        import_log(log, arm, tmp_path / "one")


def test_a_missing_reader_gives_the_line_that_installs_it(tmp_path, arm, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(RequestError) as error:
        import_log(tmp_path / "a.mcap", arm, tmp_path / "one")
    assert error.value.hint == 'pip install "labrun[ros]"'


def test_a_folder_that_is_there_is_not_overwritten(tmp_path, arm):
    log = logs.write_csv(tmp_path / "a.csv", *logs.motion())
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "mine").write_text("kept")
    with pytest.raises(RequestError, match="is not overwritten"):
        import_log(log, arm, tmp_path / "one")


def test_a_motor_current_drives_a_joint_without_an_actuator_and_stays_in_amperes(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(URDF)
    time_s, goals, angles = logs.motion()
    names = ["t", "shoulder_current", "shoulder_pos"]
    log = logs.write_csv(tmp_path / "a.csv", time_s, goals[:, :1], angles[:, :1], names)
    made = import_log(log, urdf, tmp_path / "amperes")
    assert "motor currents, in amperes: shoulder_torque" in " ".join(made.remarks)
    recording = read_recording(made.folder)
    assert [signal.unit for signal in recording.inputs] == ["A"]
    assert columns(recording, "shoulder_torque").max() == pytest.approx(goals[:, 0].max())
    assert load_model(made.folder / "model.toml").inputs[0].unit == "A"
    stated = import_log(log, urdf, tmp_path / "stated", unit="shoulder_torque=A:0.5")
    assert columns(read_recording(stated.folder), "shoulder_torque").max() == pytest.approx(
        0.5 * goals[:, 0].max()
    )
    left_out = import_log(log, urdf, tmp_path / "still", mapping=["shoulder_torque=none"])
    assert "not used: shoulder_current" in left_out.remarks
