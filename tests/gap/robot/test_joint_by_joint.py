"""Joints looked at one by one, on an arm that MuJoCo steps in short steps."""

import dataclasses
import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import gap_examples as examples
import numpy as np
import pytest

from labrun.effects import AttachedEffect, load_effect
from labrun.fit import Dataset, FitTrial, silent
from labrun.fit.output_error import fit_model
from labrun.gap import Options, diagnose_robot, parameter_ranges, why_not
from labrun.gap.diagnose import diagnose_dataset
from labrun.gap.motion import smoothed
from labrun.gap.robot.as_diagnosed import as_diagnosed
from labrun.gap.robot.diagnose import _announced, _explained_by_load, _key, _looked, _smoothing_gap
from labrun.gap.robot.diagnosis import JointDiagnosis, RobotDiagnosis
from labrun.gap.robot.links import beside_encoders, links_that_explain
from labrun.gap.robot.one_joint import Prescribed, one_joint, prescribed
from labrun.gap.robot.together import with_rate_gain_as_damping
from labrun.models import load_model, parse_model, read_robot, robot_table, simulate
from labrun.store import SignalInfo

XML = """
<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.4" armature="0.05"/>
<inertial pos="0 0 -0.2" mass="1.5" diaginertia="0.01 0.01 0.01"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" damping="0.2" armature="0.02"/>
<inertial pos="0 0 -0.15" mass="0.8" diaginertia="0.005 0.005 0.005"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="150" kv="8"/>
<position name="elbow" joint="elbow" kp="40" kv="2"/></actuator></mujoco>
"""
NOISE = 2e-4
SAMPLE_S, SAMPLES = 0.01, 220
SHORT_S = 5e-4


@cache
def log(
    friction: float = 0.0, trials: int = 5, step_s: float = SHORT_S
) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return goals and measured angles; Coulomb friction of the elbow as a spring of bristles (Dahl)."""
    import mujoco

    rng = np.random.default_rng(3)
    model = mujoco.MjModel.from_xml_string(XML)
    model.opt.timestep = step_s
    time_s = np.arange(SAMPLES) * SAMPLE_S
    fade = np.sin(np.pi * np.arange(SAMPLES) / SAMPLES) ** 1.5
    made = []
    for _ in range(trials):
        data = mujoco.MjData(model)
        frequency, phase = rng.uniform(0.4, 1.6, (2, 2)), rng.uniform(0, 6, (2, 2))
        goals = (
            0.35 * fade[:, None] * np.sin(2 * np.pi * time_s[:, None, None] * frequency + phase).sum(axis=2)
        )
        angles, bristle = np.empty_like(goals), 0.0
        for row in range(SAMPLES):
            angles[row] = data.qpos
            for _ in range(round(SAMPLE_S / step_s)):
                bristle = float(np.clip(bristle + step_s * data.qvel[1] / 2e-4, -1, 1))
                data.ctrl[:], data.qfrc_applied[1] = goals[row], -friction * bristle
                mujoco.mj_step(model, data)
        made.append((goals, angles + NOISE * rng.standard_normal(angles.shape)))
    return tuple(made)


def arm(tmp_path: Path, friction: float = 0.0, step_s: float = SHORT_S):
    file = tmp_path / "arm.xml"
    file.write_text(XML, encoding="utf-8")
    robot, model = read_robot(file), load_model(file)
    time_s = np.arange(SAMPLES) * SAMPLE_S
    trials = tuple(
        FitTrial(f"trial {k}", {"motion": f"m{k}"}, 1, time_s, goals, angles)
        for k, (goals, angles) in enumerate(log(friction, step_s=step_s))
    )
    inputs = tuple(SignalInfo(signal.name, signal.unit, "hold") for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    return robot, model, Dataset("arm", tmp_path, "recording", inputs, outputs, trials)


def test_a_joint_is_known_by_its_data_its_model_and_what_is_asked(tmp_path):
    robot, model, dataset = arm(tmp_path)

    def key(data=dataset, options=None):
        return _key(one_joint(prescribed(robot, model, data), 1), options or Options())

    noisy = dataclasses.replace(
        dataset,
        trials=tuple(dataclasses.replace(trial, outputs=trial.outputs + 1e-6) for trial in dataset.trials),
    )
    led = _key(one_joint(prescribed(robot, model, dataset).led(0.01), 1), Options())
    assert key() == key(options=Options(workers=3, within_s=60.0))
    assert len({key(), key(noisy), key(options=Options(withhold=("coulomb-friction",))), led}) == 4


class KnownJoints:
    """Answers of joints that are diagnosed, in memory."""

    def __init__(self):
        self.answers = {}

    def get(self, key):
        return self.answers.get(key)

    def keep(self, key, answer):
        self.answers[key] = answer


def test_smoothing_returns_the_motion_behind_the_noise():
    time_s = np.linspace(0, 4, 401)
    clean = np.sin(5 * time_s)
    noisy = clean + 1e-3 * np.random.default_rng(0).standard_normal(401)
    q, rate, acceleration = (column[:, 0] for column in smoothed(time_s, noisy[:, None]))
    inner = slice(30, -30)
    assert np.std((q - clean)[inner]) < 0.5e-3
    assert np.std((rate - 5 * np.cos(5 * time_s))[inner]) < 0.02
    assert np.std((acceleration + 25 * clean)[inner]) < 0.5


def test_a_joint_alone_moves_as_it_does_in_the_robot(tmp_path):
    robot, model, dataset = arm(tmp_path)
    result = prescribed(robot, model, dataset)
    for index in range(2):
        joint = one_joint(result, index)
        trial = joint.dataset.trials[0]
        moved = simulate(
            joint.model, trial.time_s, trial.inputs, initial_state=[trial.outputs[0, 0], 0.0], substeps=2
        )
        assert np.std(moved.outputs[:, 0] - trial.outputs[:, 0]) < 3 * NOISE


def test_of_servos_that_the_file_lacks_gains_and_rotors_come_out_of_the_log(tmp_path):
    _, _, dataset = arm(tmp_path)
    bare = re.sub(r"<actuator>.*</actuator>|damping=\S+|armature=\S+(?=/>)", "", XML, flags=re.DOTALL)
    file = tmp_path / "bare.xml"
    file.write_text(bare, encoding="utf-8")
    robot = read_robot(file, "undriven")
    model = parse_model(robot_table(robot), "bare")
    joint = one_joint(prescribed(robot, model, dataset), 1)
    fitted = fit_model(joint.model, joint.dataset, rng=np.random.default_rng(0), starts=1)
    result = {name: parameter.value for name, parameter in fitted.parameters.items()}
    # what brakes the joint and its servo is told as one
    truth = {"elbow_kp": 40.0, "elbow_armature": 0.02, "elbow_damping": 0.2 + 2.0}
    assert {name: result[name] for name in truth} == pytest.approx(truth, rel=0.1)


def test_where_the_torque_is_logged_a_joint_is_asked_which_torque_its_motion_takes(tmp_path):
    import mujoco

    motors = re.sub(r'<position (name="\w+" joint="\w+").*?/>', r"<motor \1/>", XML)
    (tmp_path / "motors.xml").write_text(motors, encoding="utf-8")
    simulated = mujoco.MjModel.from_xml_string(motors)
    simulated.opt.timestep, friction, rng = SHORT_S, 0.6, np.random.default_rng(4)
    time_s, trials = np.arange(SAMPLES) * SAMPLE_S, []
    for number, (goals, _) in enumerate(log()):
        data, torques, angles = mujoco.MjData(simulated), np.empty_like(goals), np.empty_like(goals)
        for row, goal in enumerate(goals):
            angles[row] = data.qpos + NOISE * rng.standard_normal(2)
            torques[row] = data.ctrl[:] = (150, 40) * (goal - data.qpos) - np.array([8, 2]) * data.qvel
            for _ in range(round(SAMPLE_S / SHORT_S)):
                data.qfrc_applied[1] = -friction * np.tanh(data.qvel[1] / 2e-3)
                mujoco.mj_step(simulated, data)
        trials.append(FitTrial(f"trial {number}", {"motion": f"m{number}"}, 1, time_s, torques, angles))
    robot, model = read_robot(tmp_path / "motors.xml"), load_model(tmp_path / "motors.xml")
    inputs = tuple(SignalInfo(signal.name, signal.unit, "hold") for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    dataset = Dataset("arm", tmp_path, "recording", inputs, outputs, tuple(trials))
    joint = one_joint(prescribed(robot, model, dataset), 1)
    assert [each.name for each in joint.model.outputs] == ["elbow_torque"]
    options = Options(workers=1, places=False, brisk=True)
    ((_, answer),) = _looked(
        prescribed(robot, model, dataset), [1], options, None, silent, np.inf, KnownJoints()
    )
    assert [str(cause.name) for cause in answer.causes] == ["coulomb-friction at elbow"]
    assert answer.causes[0].values["torque"].value == pytest.approx(friction, rel=0.05)


def test_a_joint_that_is_done_is_told_with_the_time_that_the_others_take(tmp_path):
    prepared = prescribed(*arm(tmp_path))
    options, notes, known = Options(workers=1, places=False, brisk=True, least_gap=np.inf), [], KnownJoints()
    answers = _looked(prepared, [0, 1], options, None, notes.append, np.inf, known)
    assert all(kept is answer for kept, (_, answer) in zip(known.answers.values(), answers, strict=True))
    verdicts = {joint.joint.name: answer.verdict for joint, answer in answers}
    first = rf"1 of 2 joints done, about \d+ s left; shoulder: {verdicts['shoulder']}"
    assert [note for note in notes if re.fullmatch(first, note)]
    assert notes[-1] == f"2 of 2 joints done; elbow: {verdicts['elbow']}"
    again = _looked(prepared, [0, 1], options, None, notes.append, np.inf, known)
    assert all(new is old for (_, new), (_, old) in zip(again, answers, strict=True)), (
        "nothing is diagnosed again"
    )


def test_prescribed_motion_is_no_site(tmp_path):
    robot, model, dataset = arm(tmp_path)
    places = one_joint(prescribed(robot, model, dataset), 1).model.places
    assert [(location.kind, location.name) for location in places] == [
        ("joint", "elbow"), ("link", "elbow_link"), ("controller", "elbow_controller"), ("base", "base"),
        ("tip", "tip"), ("input", "elbow_command"), ("output", "elbow"),
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["base", "tip"])
def test_a_joint_may_be_called_as_the_robots_own_places_are(tmp_path, monkeypatch, name):
    monkeypatch.setattr(f"{__name__}.XML", XML.replace('"shoulder"', f'"{name}"'))
    robot, model, dataset = arm(tmp_path)
    places = one_joint(prescribed(robot, model, dataset), 0).model.places
    other = {"base": "tip", "tip": "base"}[name]
    names = {location.kind: location.name for location in places if location.kind in ("joint", "base", "tip")}
    assert names == {"joint": name, name: f"robot_{name}", other: other}


PLAY = 0.02


def arm_with_play(tmp_path: Path) -> Prescribed:
    """Return an arm whose shoulder moves by so much before its encoder does."""
    robot, model, clean = arm(tmp_path)
    trials = []
    for trial in clean.trials:
        outputs, stands = trial.outputs.copy(), trial.outputs[0, 0]
        for row in range(len(outputs)):
            stands = outputs[row, 0] = np.clip(stands, outputs[row, 0] - PLAY / 2, outputs[row, 0] + PLAY / 2)
        trials.append(dataclasses.replace(trial, outputs=outputs))
    return prescribed(robot, model, dataclasses.replace(clean, trials=tuple(trials)))


def test_a_link_that_is_not_where_its_encoder_says_is_known_by_what_the_others_lack_no_more(tmp_path):
    """The elbow lacks something, too, as long as the shoulder is taken to be where its encoder says."""
    result = arm_with_play(tmp_path)
    links = links_that_explain(result, [0, 1], seed=0)
    assert list(links) == [0]
    assert np.abs(np.concatenate(links[0])).max() == pytest.approx(PLAY / 2, rel=0.05)
    assert links_that_explain(result, [0], seed=0) == {}


def test_what_lies_between_link_and_encoder_is_no_noise(tmp_path):
    """Else whatever hangs on the link would pass for what smoothing leaves of the others' noise."""
    result = arm_with_play(tmp_path)
    moved = result.with_links({0: [np.full(SAMPLES, 10 * NOISE)] * len(result.motions)})
    drawn = moved.redrawn(np.random.default_rng(0))
    apart = [
        first[0][:, 0] - other[0][:, 0] for first, other in zip(drawn.motions, moved.motions, strict=True)
    ]
    assert np.std(np.concatenate(apart)) < NOISE


def test_a_joint_moves_as_in_the_robot_once_the_play_of_the_encoder_before_it_is_known(tmp_path):
    result = arm_with_play(tmp_path)
    play = AttachedEffect(load_effect("play"), "shoulder", (PLAY,))
    answers = [
        (one_joint(result, 0), (play,), {}),
        (one_joint(result, 1), (), {}),
    ]
    encoders = beside_encoders(result, answers)
    assert list(encoders) == [0]
    assert np.abs(np.concatenate(encoders[0])).max() == pytest.approx(PLAY / 2, rel=1e-2)

    def differs(given: Prescribed) -> float:
        joint = one_joint(given, 1)
        trial = joint.dataset.trials[0]
        begin = [trial.outputs[0, 0], 0.0]
        moved = simulate(joint.model, trial.time_s, trial.inputs, initial_state=begin, substeps=2)
        return float(np.std(moved.outputs[:, 0] - trial.outputs[:, 0]))

    assert differs(result.with_links(encoders)) < 0.3 * differs(result)


def test_a_link_that_gives_way_asks_of_its_drive_what_gravity_asks_there(tmp_path):
    """Held still, a link that gives way by compliance times torque hangs there, and not where its motor is."""
    robot, model, dataset = arm(tmp_path)
    angles, count = np.array([0.9, 0.4]), 60
    trial = FitTrial(
        "still", {}, 1, np.arange(count) * SAMPLE_S, np.zeros((count, 2)), np.tile(angles, (count, 1))
    )
    result = prescribed(robot, model, dataclasses.replace(dataset, trials=(trial,)))

    def weight(elbow: float) -> float:
        return 0.8 * 9.81 * 0.15 * np.sin(angles[0] + elbow)

    compliance = 1e-4
    more = weight(angles[1] - compliance * weight(angles[1])) - weight(angles[1])
    assert -compliance * result.given_way(0, 1) == pytest.approx(more, rel=1e-3)


def test_what_smoothing_leaves_of_the_noise_is_felt_by_the_joint_that_hangs_on_the_others(tmp_path):
    robot, model, dataset = arm(tmp_path)
    result = prescribed(robot, model, dataset)
    drawn = result.redrawn(np.random.default_rng(0))
    shoulder, elbow = (
        _smoothing_gap(one_joint(result, index), one_joint(drawn, index)) for index in range(2)
    )
    assert 0 < shoulder < elbow < 1
    assert _smoothing_gap(one_joint(result, 1), one_joint(result, 1)) == 0


def test_what_smoothing_leaves_is_told_in_units_of_what_is_believed_of_a_model(tmp_path):
    """A far finer encoder makes no joint far more doubtful: gaps are not told in units of its noise, either."""
    robot, model, dataset = arm(tmp_path)
    result = prescribed(robot, model, dataset)
    joint, drawn = one_joint(result, 1), one_joint(result.redrawn(np.random.default_rng(0)), 1)
    column = [signal.name for signal in joint.model.inputs].index("measured")
    trials = [
        dataclasses.replace(
            trial, outputs=trial.inputs[:, [column]] + 1e-3 * (trial.outputs - trial.inputs[:, [column]])
        )
        for trial in joint.dataset.trials
    ]
    finer = dataclasses.replace(joint, dataset=dataclasses.replace(joint.dataset, trials=tuple(trials)))
    assert 0 < _smoothing_gap(finer, drawn) < 5 * _smoothing_gap(joint, drawn)


@pytest.mark.slow
def test_friction_is_named_at_its_joint_and_nothing_at_the_other(tmp_path):
    robot, model, dataset = arm(tmp_path, friction=0.25)
    messages: list[str] = []
    diagnosis = diagnose_robot(robot, model, dataset, Options(workers=2), note=messages.append)
    shoulder, elbow = diagnosis.joints
    assert [str(cause.name) for cause in elbow.diagnosis.causes] == ["coulomb-friction at elbow"]
    assert elbow.diagnosis.causes[0].values["torque"].value == pytest.approx(0.25, rel=0.1)
    assert not shoulder.diagnosis.causes
    assert elbow.corrected < 0.5 * elbow.recalibrated
    assert diagnosis.sentence == "1 of 2 joints lack physics: elbow: Coulomb friction."
    assert any("2 of 2 joints" in message for message in messages)


@pytest.mark.slow
def test_a_simulators_own_time_step_is_no_early_clock(tmp_path):
    robot, model, dataset = arm(tmp_path, step_s=2e-3)
    diagnosis = diagnose_robot(robot, model, dataset, Options(workers=2))
    assert not diagnosis.named
    assert any("-clock" in note for joint in diagnosis.joints for note in joint.diagnosis.notes)


def test_a_motor_behind_a_gear_drives_its_joint_with_what_the_gear_makes_of_its_control(tmp_path):
    _, _, dataset = arm(tmp_path)
    servo = '<position name="elbow" joint="elbow" kp="40" kv="2"/>'
    asked = {}
    for gear in (1, 48):
        file = tmp_path / f"geared-{gear}.xml"
        file.write_text(
            XML.replace(servo, f'<motor name="elbow" joint="elbow" gear="{gear}"/>'), encoding="utf-8"
        )
        robot, model = read_robot(file), load_model(file)
        inputs = tuple(SignalInfo(signal.name, signal.unit) for signal in model.inputs)
        joint = one_joint(prescribed(robot, model, dataclasses.replace(dataset, inputs=inputs)), 1)
        trial = joint.dataset.trials[0]
        asked[gear] = simulate(joint.model, trial.time_s, trial.inputs, initial_state=[]).outputs[:, 0]
    assert [(actuator.input, actuator.unit) for actuator in robot.actuators][1] == ("elbow_control", "1")
    np.testing.assert_allclose(48 * asked[48], asked[1])


def test_what_cannot_be_taken_apart_is_told(tmp_path):
    robot, _, dataset = arm(tmp_path)
    assert why_not(robot, dataset) == ""
    alone = dataclasses.replace(dataset, outputs=dataset.outputs[:1])
    assert why_not(robot, alone) == "the log has no angle of elbow"
    tied = XML.replace(
        "</worldbody>", '</worldbody><equality><joint joint1="shoulder" joint2="elbow"/></equality>'
    )
    file = tmp_path / "tied.xml"
    file.write_text(tied, encoding="utf-8")
    assert why_not(read_robot(file), dataset) == "equality constraints tie its joints together"


def test_what_a_rate_gain_changed_by_goes_into_the_damping_of_the_whole_robot():
    stated = {"elbow_damping": 0.4, "servo_kv": 2.0, "elbow_kp": 40.0}
    values = {"elbow_damping": 0.5, "servo_kv": 2.2, "elbow_kp": 40.0}
    assert with_rate_gain_as_damping(values, stated) == {
        "elbow_damping": pytest.approx(0.7),
        "elbow_kp": 40.0,
    }
    assert with_rate_gain_as_damping({"servo_kv": 2.2}, stated) == {"elbow_damping": pytest.approx(0.6)}


def test_a_gain_that_alone_explains_a_joint_by_being_far_from_what_is_stated_is_told():
    def joint(
        kp: float, tolerance: float | str = 0.1, verdict: str = "no-gap", raw: float = 5.0
    ) -> JointDiagnosis:
        recalibration = {"elbow_kp": (40.0, tolerance, kp), "mass_ratio": (1.0, 0.05, 1.04)}
        gap = SimpleNamespace(raw=raw)
        namespace = SimpleNamespace(causes=(), verdict=verdict, recalibration=recalibration, gap=gap)
        return JointDiagnosis(SimpleNamespace(name="elbow"), namespace, 0.1, 0.01, 0.01)

    assert joint(28.0).moved == {"elbow_kp": pytest.approx(0.7)}
    assert joint(36.0).moved == {}
    assert joint(28.0, "free").moved == {}
    assert joint(28.0, verdict="unexplained").moved == {}
    assert joint(28.0, raw=0.5).moved == {}  # it moves as stated, to within the noise
    diagnosis = RobotDiagnosis("arm", "arm", "log", (joint(28.0), joint(41.0)), (), (), {}, (), 1.0)
    assert diagnosis.sentence == "parameters are far from what is stated: elbow_kp -30 %."


def test_a_mass_is_told_only_where_the_joints_that_carry_it_agree():
    namespace = SimpleNamespace(
        causes=(), verdict="no-gap", recalibration={"hand_mass_ratio": (1.0, 0.05, 1.3)},
        gap=SimpleNamespace(raw=5.0),
    )  # fmt: skip

    def elbow(median: float) -> JointDiagnosis:
        return JointDiagnosis(
            SimpleNamespace(name="elbow"), namespace, 0.1, 0.01, 0.01, {"hand_mass_ratio": median}
        )

    assert elbow(1.25).moved == {"hand_mass": pytest.approx(1.3)}
    assert elbow(1.02).moved == {}


def test_of_two_places_that_as_many_joints_tell_a_load_at_the_one_that_leaves_less_counts():
    def loaded(*afters: float, effect: str = "payload") -> list:
        cause = SimpleNamespace(name=SimpleNamespace(effect=effect))
        return [(None, SimpleNamespace(causes=[cause], gap=SimpleNamespace(after=after))) for after in afters]

    assert _explained_by_load(loaded(5.1, 19.0), [0, 1]) < _explained_by_load(loaded(4.1, 7.7), [0, 1])
    assert _explained_by_load(loaded(0.1, 0.1, effect="bias"), [0, 1]) < _explained_by_load(
        loaded(9.0, 9.0), [0, 1]
    )


def test_where_recalibration_leaves_less_than_is_asked_for_no_cause_is_looked_for(tmp_path):
    joint = one_joint(prescribed(*arm(tmp_path, friction=0.25)), 1)
    options = Options(places=False, brisk=True, least_gap=1e3)
    answer = diagnose_dataset(joint.dataset, joint.model, options)
    assert not answer.causes
    assert not answer.candidates
    assert 1.0 < answer.gap.recalibrated < 1e3


def test_a_gain_that_leaves_no_gap_once_it_is_recalibrated_is_told_all_the_same():
    """The gap it makes is gone with it: nothing is left to announce, but how far it is off."""
    parameter = examples.parameter()
    answer = _announced(
        dataclasses.replace(parameter, gap=dataclasses.replace(parameter.gap, recalibrated=0.0)), 0.3, 0.002
    )
    assert not answer.causes
    joint = JointDiagnosis(SimpleNamespace(name="hinge"), answer, 1.0, 0.1, 0.1)
    assert joint.moved == {"inertia": pytest.approx(5.1 / 3.9)}


def stored(**more):
    """Return a diagnosis of the arm as it is stored, without causes where none is given."""
    empty = {"effects": [], "corrected": {}}
    joints = [{"joint": name, "diagnosis": {**empty, **more.get(name, {})}} for name in ("shoulder", "elbow")]
    return {
        "joints": joints,
        "corrected": more.get("corrected", {}),
        "whole": more.get("whole", []),
        "seed": 0,
    }


def test_ranges_hold_what_is_true_of_every_joint_and_link(tmp_path):
    robot, model, dataset = arm(tmp_path)
    diagnosis = stored(corrected={"elbow_kp": 41.0, "lower_mass": 0.82})
    ranges = parameter_ranges(robot, model, dataset, diagnosis)
    true = {parameter.name: parameter.value for parameter in model.parameters if parameter.tolerance != 0.0}
    assert set(ranges) == set(true)
    for name, value in true.items():
        assert ranges[name].ci95[0] <= value <= ranges[name].ci95[1], name


def test_ranges_are_those_beside_the_cause(tmp_path):
    robot, model, dataset = arm(tmp_path, friction=0.5)
    friction = {"effect": "coulomb-friction", "kind": "joint", "site": "elbow", "values": [0.5, 0.01, 2e-4]}
    ranges = parameter_ranges(robot, model, dataset, stored(elbow={"effects": [friction]}))
    without = parameter_ranges(robot, model, dataset, stored())
    assert ranges["elbow_damping"].value == pytest.approx(0.2, rel=0.2)
    assert without["elbow_damping"].value > 0.4  # friction is taken for damping


def test_ranges_are_fitted_with_the_base_the_load_and_the_clock_that_were_found(tmp_path):
    robot, model, dataset = arm(tmp_path)
    result = prescribed(robot, model, dataset)
    at = result.tip.far_end + np.array([0.1, 0.0, 0.0])
    position = dict(zip("xyz", at.tolist(), strict=True))
    play = {"effect": "play", "kind": "output", "site": "shoulder", "values": [1e-9]}
    message = stored(
        shoulder={"effects": [play]},  # links are then prescribed anew
        whole=[
            {"effect": "gravity-tilt", "joints": ["elbow"], "values": {"roll": 0.1, "pitch": -0.2}},
            {"effect": "payload", "joints": ["elbow"], "values": {"mass": 0.3, **position}},
            {"effect": "delay", "joints": ["elbow"], "values": {"time": 0.01}},
        ],
    )
    around = as_diagnosed(result, message)
    assert around.lead_s == -0.01
    wanted = result.with_load_at(result.tip.torque(at)).on_base(0.1, -0.2).loaded(0.3).around
    np.testing.assert_allclose(np.concatenate(around.around), np.concatenate(wanted), atol=1e-5)
