"""Each joint has its own unit: stated, asked for, or told by the ranges of all joints together."""

import numpy as np
import pytest
import robot_logs as logs

from labrun.app.logs import LogAnswers, import_log, preview_log
from labrun.errors import RequestError
from labrun.logs import AskedUnits, Match, Stream, Wanted, column, decide_units, questions
from labrun.store import read_recording

GRIPPER = """
<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.5"/>
<inertial pos="0 0 -.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
<body name="jaw" pos="0 0 -.2"><joint name="gripper" axis="0 1 0" range="-0.2 1.8" damping="0.3"/>
<inertial pos="0 0 -.1" mass="0.2" diaginertia="5e-4 5e-4 5e-4"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="20"/><position joint="gripper" kp="10"/></actuator></mujoco>
"""


@pytest.fixture
def hand(tmp_path):
    path = tmp_path / "hand.xml"
    path.write_text(GRIPPER)
    return path


def opened():
    """Return time, goals and angles of a shoulder in degrees and a gripper of 0 to 100."""
    time_s, goals, angles = logs.motion()
    scale, shift = np.array([60.0, -190.0]), np.array([0.0, 2.0])
    return time_s, goals * scale + shift, angles * scale + shift


def test_a_gripper_of_0_to_100_beside_degrees_is_asked_about_and_takes_its_own_unit(tmp_path, hand):
    made = opened()
    names = ["time_s", "shoulder_cmd", "gripper_cmd", "shoulder_pos", "gripper_pos"]
    log = logs.write_csv(tmp_path / "log.csv", *made, names=names)
    with pytest.raises(RequestError, match="proposal: --unit gripper=percent"):
        import_log(log, hand, tmp_path / "recording")
    answers = LogAnswers(units=["gripper=percent"])
    result = import_log(log, hand, tmp_path / "recording", answers=answers)
    outputs = np.concatenate([trial.outputs for trial in read_recording(result.folder).trials])
    assert outputs[:, 0].max() == pytest.approx(np.deg2rad(made[2][:, 0].max()), abs=0.01)
    assert outputs[:, 1].max() == pytest.approx(-0.2 + 2.0 * made[2][:, 1].max() / 100, abs=0.01)
    assert "measured angles of gripper are in percent of the joint's range, as --unit says" in result.remarks


@pytest.mark.parametrize("robot_type", ["so101_follower", "so-100", "koch_follower"])
def test_the_gripper_of_a_known_lerobot_robot_needs_no_question(tmp_path, hand, robot_type):
    pytest.importorskip("pyarrow")
    _, goals, angles = opened()
    folder = logs.write_lerobot(
        tmp_path / "set", goals, angles, names=("shoulder", "gripper"), robot_type=robot_type
    )
    asked = preview_log(folder, hand).questions
    assert [question.text for question in asked if "gripper" in question.text] == []
    for number, units in enumerate((["deg"], ["shoulder=deg"])):
        answers = LogAnswers(units=units)
        result = import_log(folder, hand, tmp_path / f"recording{number}", answers=answers)
        assert any(
            "gripper are in percent" in text and "as the log states" in text for text in result.remarks
        )
    answers = LogAnswers(units=["deg", "gripper=deg"])
    result = import_log(folder, hand, tmp_path / "degrees", answers=answers)
    assert "measured angles are in degrees, as --unit says" in result.remarks


def decided(reach, ranges, asked=()):
    """Return the units of joints that reach so far, and what is asked; `ranges`: rad or None, by joint."""
    time_s = 0.01 * np.arange(400)
    matches = []
    for name, most in reach.items():
        angle = column("", f"{name}_pos", most * np.sin(time_s))
        wanted = Wanted(name, "rad", "output", (name,), ("position",), range=ranges.get(name))
        matches.append(Match(wanted, Stream("log", time_s, (angle,)), angle))
    ((made), findings) = decide_units([matches], AskedUnits.parsed(asked, ()))
    return {match.wanted.channel: match.unit for match in made[0]}, questions(findings)


def test_a_joint_that_whirls_makes_no_degrees_of_radians():
    units, asked = decided({"wheel": 9.01, "pan": 1.4, "tilt": 0.8}, {"pan": (-2, 2), "tilt": (-1, 1)})
    assert set(units.values()) == {"rad"}
    assert asked[0].proposal == "--unit rad"
    for evidence in ("wheel reaches 9.01, without a range", "tilt reaches 0.8 of -1 to 1 rad"):
        assert evidence in asked[0].text
    units, asked = decided({"wheel": 9.01, "pan": 1.4}, {"pan": (-2, 2)}, asked=["rad"])
    assert not asked
    assert set(units.values()) == {"rad"}


def test_joints_that_leave_their_ranges_in_radians_are_in_degrees_without_a_question():
    units, asked = decided({"pan": 80.0, "tilt": 40.0}, {"pan": (-2, 2), "tilt": (-1, 1)})
    assert set(units.values()) == {"deg"}
    assert not asked


def test_ticks_that_wrap_are_ticks(tmp_path):
    """In degrees a step of 4096 looks like eleven turns: whole numbers are judged as they are."""
    time_s = 0.01 * np.arange(800)
    angles = np.column_stack([5.6 * np.sin(0.8 * time_s), np.sin(time_s)])
    ticks = np.round(4096 / (2 * np.pi) * angles + 2048) % 4096
    path = logs.write_csv(tmp_path / "log.csv", time_s, ticks, ticks)
    (tmp_path / "arm.xml").write_text(logs.ARM.replace('range="-2 2"', ""))
    preview = preview_log(path, tmp_path / "arm.xml")
    assert not preview.questions
    shoulder = next(row for row in preview.channels if row.channel == "shoulder")
    assert (shoulder.unit, shoulder.lowest) == ("ticks", pytest.approx(-5.6, abs=0.01))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("elbo=deg", "the model has no 'elbo'"),
        ("furlong", "is no unit of angles"),
        ("deg:3", "is no unit of angles"),
        ("ticks:-4", "is no unit of angles"),
    ],
)
def test_an_answer_that_fits_nothing_is_refused_by_name(text, message):
    with pytest.raises(RequestError, match=message):
        decided({"pan": 0.5}, {}, asked=[text])


def test_a_slide_whose_log_is_in_millimetres_or_percent_is_asked_about(tmp_path):
    time_s = 0.01 * np.arange(400)
    for most, unit in ((35.0, "mm"), (99.0, "percent")):
        opening = column("", "finger_pos", most * (0.5 + 0.5 * np.sin(time_s)))
        wanted = Wanted("finger", "m", "output", ("finger",), ("position",), range=(0.0, 0.04))
        ((made,), findings) = decide_units(
            [[Match(wanted, Stream("log", time_s, (opening,)), opening)]], AskedUnits.parsed((), ())
        )
        (question,) = questions(findings)
        assert unit in (question.proposal + question.answers)
        assert made[0].in_si().max() <= 0.041


def test_a_unit_in_brackets_behind_a_name_is_what_the_log_states(tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(logs.ARM)
    time_s, goals, angles = logs.motion()
    names = ["time [ms]", "shoulder_cmd [deg]", "elbow_cmd [deg]", "shoulder_pos [deg]", "elbow_pos (deg)"]
    log = logs.write_csv(tmp_path / "log.csv", 1000 * time_s, 5 * goals, 5 * angles, names=names)
    result = import_log(log, arm, tmp_path / "recording")
    assert "measured angles are in degrees, as the log states" in result.remarks
    assert 9 < result.duration_s < 12


def test_amperes_are_no_torque_until_somebody_says_how_much_torque_one_is(tmp_path):
    arm = tmp_path / "motor.xml"
    arm.write_text(logs.ARM.replace('<position joint="shoulder" kp="20"/>', '<motor joint="shoulder"/>'))
    time_s, goals, angles = logs.motion()
    names = ["time_s", "shoulder_current", "elbow_cmd", "shoulder_pos", "elbow_pos"]
    log = logs.write_csv(tmp_path / "log.csv", time_s, goals, angles, names=names)
    with pytest.raises(RequestError, match="shoulder_current is a current, and amperes are not N m"):
        import_log(log, arm, tmp_path / "recording")
    result = import_log(log, arm, tmp_path / "recording", unit="shoulder_torque=A:0.25")
    inputs = np.concatenate([trial.inputs for trial in read_recording(result.folder).trials])
    assert inputs[:, 0].max() == pytest.approx(0.25 * goals[:, 0].max(), rel=1e-6)
