"""The joints of a topic are those of all its messages; joints, writers and clocks that differ are kept apart."""

import numpy as np
import pytest
import robot_logs as logs

from labrun.app.logs import LogAnswers, import_log, preview_log
from labrun.errors import RequestError
from labrun.logs import questions, read_log
from labrun.store import read_recording

pytest.importorskip("rosbags")
ZERO = 1_700_000_000 * 10**9
JOINTS = ("shoulder", "elbow")


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(logs.ARM)
    return path


def write_states(path, messages, topic="/joint_states", goals=None):
    """Write a bag of joint states; a message is receipt (s), stamp (s) or None, names, positions, frame.

    `goals`: (receipt, names, positions) of /goal_command.
    """
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, kind = store.types, "sensor_msgs/msg/JointState"

    def state(stamp_s, names, positions, frame=""):
        whole = 0 if stamp_s is None else ZERO + round(stamp_s * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](sec=whole // 10**9, nanosec=whole % 10**9)
        return types[kind](
            header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame), name=list(names),
            position=np.array(positions, dtype=float), velocity=np.array([]), effort=np.array([]),
        )  # fmt: skip

    rows = [(receipt, topic, state(stamp, *rest)) for receipt, stamp, *rest in messages]
    rows += [(receipt, "/goal_command", state(None, *rest)) for receipt, *rest in goals or ()]
    with Writer(path, version=9) as writer:
        connections = {
            name: writer.add_connection(name, kind, typestore=store) for name in {row[1] for row in rows}
        }
        for receipt_s, name, message in sorted(rows, key=lambda row: row[0]):
            stamp = ZERO + round(receipt_s * 1e9)
            writer.write(connections[name], stamp, store.serialize_cdr(message, kind))
    return path


def motion_rows(scale=1.0, rate=1.0, offset_s=0.0, delay_s=0.002):
    """Return the messages of a motion whose clock runs at `rate` of the recorder's; its goals have receipts alone."""
    time_s, goals, angles = logs.motion(moves=4)
    states = [
        (t / rate + delay_s, t + offset_s, JOINTS, scale * angle)
        for t, angle in zip(time_s, angles, strict=True)
    ]
    message = [(t / rate, JOINTS, scale * goal) for t, goal in zip(time_s, goals, strict=True)]
    return states, message


@pytest.mark.parametrize("first", [(), ("shoulder",)])
def test_a_partial_first_message_loses_no_joint(tmp_path, arm, first):
    states, goals = motion_rows()
    states[0] = (states[0][0], states[0][1], first, [0.0] * len(first))
    result = import_log(write_states(tmp_path / "bag", states, goals=goals), arm, tmp_path / "recording")
    assert dict(result.channels)["elbow"] == "/joint_states/position/elbow"
    expected = "1 message without a joint" if not first else "its messages name 2 different sets of joints"
    assert expected in " ".join(result.remarks)


def test_values_are_matched_by_name_in_every_message(tmp_path):
    states, _ = motion_rows()
    turned = [
        (receipt, stamp, names[::-1], positions[::-1]) if number % 2 else (receipt, stamp, names, positions)
        for number, (receipt, stamp, names, positions) in enumerate(states)
    ]
    first = read_log(write_states(tmp_path / "a", states))
    second = read_log(write_states(tmp_path / "b", turned))
    for before, after in zip(first[0].columns, second[0].columns, strict=True):
        assert (before.name, before.stem) == (after.name, after.stem)
        assert np.array_equal(before.values, after.values)


def test_joints_that_are_polled_in_turn_keep_their_own_stamps(tmp_path, arm):
    states, goals = motion_rows()
    polled = [
        (receipt + 0.005 * index, stamp + 0.005 * index, (name,), [positions[index]])
        for receipt, stamp, names, positions in states
        for index, name in enumerate(names)
    ]
    bag = write_states(tmp_path / "bag", polled, goals=goals)
    streams = {stream.columns[0].stem: stream for stream in read_log(bag) if stream.name == "/joint_states"}
    assert set(streams) == set(JOINTS)
    assert streams["elbow"].time_s - streams["shoulder"].time_s == pytest.approx(0.005)
    result = import_log(bag, arm, tmp_path / "recording")
    assert result.trials == 4


def test_a_joint_of_a_slower_rate_is_resampled_closely_and_the_loss_is_told(tmp_path, arm):
    """At 20 Hz straight lines miss a motion of 1 Hz by 12 mrad."""
    time_s = 0.01 * np.arange(600)
    motion = np.sin(2 * np.pi * time_s)
    lines = ["time,shoulder_cmd,elbow_cmd,shoulder_pos,elbow_pos"]
    for row, angle in enumerate(motion):
        lines.append(f"{time_s[row]},{angle},{angle},{angle},{angle if row % 5 == 2 else ''}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    result = import_log(tmp_path / "log.csv", arm, tmp_path / "recording")
    (trial,) = read_recording(result.folder).trials
    assert trial.outputs[10:-10, 1] == pytest.approx(trial.outputs[10:-10, 0], abs=1e-3)
    message = next(text for text in result.remarks if text.startswith("elbow has stamps of its own"))
    assert 1e-3 < float(message.rpartition(" by ")[2].split()[0]) < 1e-2


def test_columns_of_a_sparse_table_keep_their_own_stamps(tmp_path):
    """As PlotJuggler exports topics of different rates: most cells of a row are blank."""
    lines = ["__time,/goal/shoulder,/state/shoulder"]
    for row in range(300):
        lines.append(f"{row * 0.01},,{np.sin(0.1 * row)}")
        if row % 5 == 0:
            lines.append(f"{row * 0.01 + 0.001},{row},")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    streams = read_log(tmp_path / "log.csv")
    assert sorted(len(stream.time_s) for stream in streams) == [60, 300]
    assert all(np.isfinite(stream.columns[0].values).all() for stream in streams)


@pytest.mark.parametrize("frame", ["other", ""])
def test_a_second_writer_that_sends_zeros_is_asked_about_and_left_out(tmp_path, arm, frame):
    states, goals = motion_rows()
    zeros = [(receipt + 0.004, stamp + 0.004, JOINTS, [0.0, 0.0], frame) for receipt, stamp, _, _ in states]
    bag = write_states(tmp_path / "bag", states + zeros, goals=goals)
    with pytest.raises(RequestError, match="2 writers tell different values of shoulder") as asked:
        import_log(bag, arm, tmp_path / "recording")
    flag = str(asked.value).partition("proposal: --publisher ")[2].partition(";")[0]
    result = import_log(bag, arm, tmp_path / "recording", answers=LogAnswers(publishers=[flag]))
    reference = import_log(write_states(tmp_path / "one", states, goals=goals), arm, tmp_path / "reference")
    values = [
        np.concatenate([trial.outputs for trial in read_recording(log.folder).trials])
        for log in (result, reference)
    ]
    # where a joint stands within its noise of zero, nothing tells whose a message is
    assert abs(len(values[0]) - len(values[1])) < 0.1 * len(values[1])
    assert np.ptp(values[0], axis=0) == pytest.approx(np.ptp(values[1], axis=0), abs=0.01)


def test_a_noisy_encoder_and_a_fast_motion_are_one_writer(tmp_path):
    rng = np.random.default_rng(0)
    time_s = np.arange(0, 6, 0.01)
    for position in (
        np.round(100 * np.sin(time_s) + rng.standard_normal(len(time_s))) / 100,
        np.sin(2 * np.pi * 12 * time_s),
        np.where(time_s % 0.5 < 0.25, 1.0, 0.0),
    ):
        states = [(t, t, ("shoulder",), [value]) for t, value in zip(time_s, position, strict=True)]
        folder = tmp_path / f"bag{position[7]:.3f}"
        assert not [
            q for stream in read_log(write_states(folder, states)) for q in questions(stream.findings)
        ]


@pytest.mark.parametrize("rate", [0.98, 1.0005])
def test_topics_of_clocks_that_run_at_other_rates_are_put_on_one(tmp_path, arm, rate):
    """Goals are stamped by the recorder, angles by a clock of another rate: at the end both belong together again."""
    states, goals = motion_rows(rate=rate)
    bag = write_states(tmp_path / "bag", states, goals=goals)
    result = import_log(bag, arm, tmp_path / "recording")
    message = next(text for text in result.remarks if "its clock runs at" in text)
    assert float(message.split()[5]) == pytest.approx(rate, rel=1e-4)
    last = read_recording(result.folder).trials[-1]
    lead = [np.sum((np.roll(last.inputs[:, 0], shift) - last.outputs[:, 0]) ** 2) for shift in range(-20, 21)]
    straight = [
        np.sum((np.roll(goal, shift) - angle) ** 2)
        for shift in range(-20, 21)
        for goal, angle in [(logs.motion()[1][:, 0], logs.motion()[2][:, 0])]
    ]
    assert int(np.argmin(lead)) == pytest.approx(int(np.argmin(straight)), abs=1)


def test_a_clock_that_was_set_while_the_log_ran_is_asked_about(tmp_path, arm):
    states, goals = motion_rows()
    jumped = [
        (receipt, stamp + (0.8 if stamp > 8.0 else 0.0), names, positions)
        for receipt, stamp, names, positions in states
    ]
    bag = write_states(tmp_path / "bag", jumped, goals=goals)
    (question,) = [q for q in preview_log(bag, arm).questions if "a clock that was set" in q.text]
    assert question.proposal == "--stamps receipt"
    result = import_log(bag, arm, tmp_path / "recording", answers=LogAnswers(stamps="receipt"))
    assert result.trials == 4
