"""Sealed robots: what is made of a seed, and that what is hidden is there."""

import json

import numpy as np
import pytest
from labrun_plugins.cases.robots import case
from labrun_plugins.cases.robots.body import draw
from labrun_plugins.cases.robots.case import make_robot
from labrun_plugins.cases.robots.hidden import EFFECTS, Joint, draw_shape

from labrun.blind.robot_check import _judged
from labrun.fit import load_dataset
from labrun.gap import why_not
from labrun.models import load_model, read_robot

STEP_S = 1e-3


def joint(effect: str, size: float) -> Joint:
    shape = draw_shape(np.random.default_rng(0))
    return Joint(40.0, 2.0, 0.05, STEP_S, 2.0, {effect: size}, shape)


def test_a_robot_is_the_same_for_the_same_seed_and_labrun_reads_it(tmp_path):
    name = make_robot(1, 2, tmp_path)  # nothing is hidden in it: made in half a second
    assert name == make_robot(1, 2, tmp_path / "again")
    folder, again = tmp_path / "cases" / name, tmp_path / "again" / "cases" / name
    for file in folder.iterdir():
        assert file.read_bytes() == (again / file.name).read_bytes()
    answer = json.loads((tmp_path / "sealed" / f"{name}.json").read_text(encoding="utf-8"))
    robot = read_robot(folder / "robot.xml")
    dataset = load_dataset(folder, load_model(folder / "robot.xml"))
    assert len(robot.joints) == answer["joints"]
    assert why_not(robot, dataset) == ""
    assert len({str(trial.condition) for trial in dataset.trials}) == len(dataset.trials) == 10
    assert sum(len(trial.time_s) for trial in dataset.trials) * 0.01 == pytest.approx(60.0, abs=0.5)
    quiet = min(float(trial.outputs[:15].std(axis=0).max()) for trial in dataset.trials)
    assert quiet < 3 * answer["noise_rad"]


@pytest.mark.parametrize("seed", range(6))
def test_robots_have_six_to_twelve_joints_and_differ_from_their_file(seed):
    rng = np.random.default_rng(seed)
    stated = draw(rng)
    assert 6 <= len(stated.links) <= 12
    built = stated.scattered(rng, 0.03, 0.05)
    ratios = np.array([b.mass / s.mass for b, s in zip(built.links, stated.links, strict=True)])
    assert 0 < np.std(ratios) < 0.08


@pytest.mark.parametrize("effect", [None, "elastic-transmission"])
def test_a_robot_hides_no_error_of_its_integrator(monkeypatch, effect):
    """Nor does a motor behind a gear that gives way: a quarter of a millisecond of its own hid what the gear does."""
    rng = np.random.default_rng(0)
    body = draw(rng)
    link = body.links[1]

    def course() -> np.ndarray:
        sizes, half_step = {"elastic-transmission": 3.0 * link.kp}, 0.5 * case.STEP_S
        motor = Joint(
            link.kp, link.kv, link.armature, half_step, 1.0, sizes, draw_shape(np.random.default_rng(0))
        )
        return case.run(body, goal, {} if effect is None else {1: motor})[0]

    goal = case.goals(rng, len(body.links))[:120]
    coarse = course()
    monkeypatch.setattr(case, "STEP_S", 0.25 * case.STEP_S)
    fine = course()
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.2 * case.NOISE_RAD[0]


@pytest.mark.parametrize("effect", [effect for effect in EFFECTS if effect not in ("play", "delay")])
def test_what_is_hidden_changes_the_torque(effect):
    time_s = np.arange(0, 2, STEP_S)
    q, rate, goal = 0.3 * np.sin(6 * time_s), 1.8 * np.cos(6 * time_s), 0.4 * np.sin(6 * time_s + 0.3)
    size = {"elastic-transmission": 400.0, "torque-speed-limit": 2.0, "loop-delay": 0.01}.get(effect, 0.2)
    hidden = joint(effect, size)
    plain, planned = 40.0 * (goal - q) - 2.0 * rate, 5.0 * np.cos(q)
    torque = [hidden.torque(*sample) for sample in zip(time_s, goal, q, rate, planned, strict=True)]
    assert np.sqrt(np.mean((torque - plain) ** 2)) > 0.02 * np.std(plain)


def test_play_keeps_what_is_measured_half_its_width_behind():
    hidden = joint("play", 0.02)
    path = np.concatenate([np.linspace(0, 0.1, 50), np.linspace(0.1, -0.1, 100)])
    measured = np.array([hidden.measured(float(value)) for value in path])
    assert measured[49] == pytest.approx(0.09)
    assert measured[-1] == pytest.approx(-0.09)


def test_an_integral_adds_up_the_error_that_a_step_saw_in_its_middle():
    hidden = joint("integral-term", 0.5)
    for _ in range(200):  # each step asks at its beginning and in its middle, dt is half of it
        hidden.torque(0.0, 0.1, 0.0, 0.0)
    assert hidden.torque(0.0, 0.1, 0.0, 0.0) == pytest.approx(
        40.0 * 0.1 * (1.0 + 200 * STEP_S / 0.5), rel=1e-9
    )


def test_a_profile_takes_the_drive_to_its_goal_within_its_limits():
    hidden = joint("motion-profile", 0.4)
    ramp_s = hidden.shape["ramp_s"]
    torque = np.array([hidden.torque(0.0, 1.0 * (k > 0), 0.0, 0.0) for k in range(3000)])
    index = torque / 40.0
    assert np.max(np.diff(index)) <= 0.8 * STEP_S * (1 + 1e-9)
    whole_s = 1.0 / 0.8 + ramp_s
    assert index[1 + round(whole_s / STEP_S / 2)] == pytest.approx(0.5, abs=2e-3)
    assert index[-1] == pytest.approx(1.0, abs=1e-6)


def test_a_link_with_play_is_not_held_within_it():
    hidden = joint("drive-play", 0.1)
    assert [hidden.torque(0.0, 0.0, 0.0, 0.0), hidden.torque(0.0, 0.0, 0.04, 0.0)] == [0.0, 0.0]
    assert hidden.torque(0.0, 0.0, 0.06, 0.0) < 0.0


@pytest.mark.parametrize("effect", ["gravity-compensation", "dynamics-feedforward"])
def test_a_controller_that_knows_the_torque_holds_its_joint_at_the_goal(effect):
    body = draw(np.random.default_rng(0))
    goal, link = np.full((150, len(body.links)), 0.3), body.links[1]
    knowing = Joint(link.kp, link.kv, link.armature, 0.5 * STEP_S, 1.0, {effect: 1.0}, {})
    with_it, without = (case.run(body, goal, drives)[0][-1, 1] - 0.3 for drives in ({1: knowing}, {}))
    assert abs(without) > 1e-3
    assert abs(with_it) < 0.1 * abs(without)


def test_a_delayed_goal_acts_a_delay_later():
    hidden = joint("delay", 0.0105)
    torques = [hidden.torque(k * STEP_S, float(k), 0.0, 0.0) for k in range(100)]
    assert torques[60] == pytest.approx(40.0 * (60 - 10.5))


def test_a_joint_is_judged_by_what_was_hidden_there():
    answer = {
        "case": "case-0001", "whole": {},
        "hidden": [{"joint": "a", "effect": "cogging", "gap": 5.0}, {"joint": "b", "effect": "drive-gain", "gap": 2.0}],
    }  # fmt: skip
    message = {
        "a": [["stribeck-friction at a", "cogging at a"]],
        "b": [["b_kp at b_kp"]],
        "c": [["delay at c"]],
        "d": [],
    }
    judged = {judged_joint.joint: judged_joint.right for judged_joint in _judged(answer, message, [])}
    assert judged == {"a": True, "b": True, "c": False, "d": True}
    tilted = {"case": "case-0002", "whole": {"gravity": [0, 0, -9.8]}, "hidden": []}
    whole: list[tuple[str, str, bool]] = []
    judged = {
        judged_joint.joint: judged_joint.right
        for judged_joint in _judged(tilted, {"a": [["gravity-tilt at base"]], "b": [["cogging at b"]]}, whole)
    }
    assert judged == {"a": True, "b": False}
    assert whole == [("case-0002", "gravity-tilt", True)]
