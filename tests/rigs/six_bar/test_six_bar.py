"""The six-bar linkage on the bench: rest, swing, poses, memory, and what the fit says of a swing it knows."""

import json

import numpy as np
import pytest
from labrun_plugins.rigs.six_bar.linkage import loop_opening
from labrun_plugins.rigs.six_bar.rest_fit import swing, swings_of
from labrun_plugins.rigs.six_bar.scene import SixBar

import labrun
from labrun.devices import HingeAngle, OrientationAngles, Trajectory
from labrun.errors import FitError, SpecError
from labrun.experiment import shipped_experiments
from labrun.fit import FitTrial

JOINTS = tuple(f"theta_{number}" for number in range(1, 7))
BODIES = tuple(f"body_{number}" for number in range(1, 7))
SIMULATED = (0.280, 0.056, 0.431, -0.470, -0.157, -0.193)
"""Table 3.3 of the source."""
HINGES = {
    "theta_1": ("body_1", "body_2", 0.0),
    "theta_2": ("body_1", "body_6", -142.6),
    "theta_3": ("body_2", "body_3", 35.3),
    "theta_4": ("body_6", "body_5", 197.4),
    "theta_5": ("body_3", "body_4", 77.9),
    "theta_6": ("body_5", "body_4", 177.4),
}


def bench(seed=0, **keys):
    return SixBar({"noise": 0, **keys}, np.random.default_rng(seed))


def released(made, angle_deg, time_s):
    """Bend theta_5 within a second, hold it for another, let go, and look."""
    made.observe(JOINTS, np.zeros(1))
    angle = np.radians([-8.8, angle_deg, angle_deg])
    made.drive("theta_5", Trajectory(("theta_5",), np.array([0.0, 1.0, 1e9]), angle[:, None]), 0.0)
    made.observe(JOINTS, np.array([2.0]))
    made.drive("theta_5", Trajectory(("theta_5",), np.zeros(1), angle[-1:, None]), 2.0)
    return made.observe(JOINTS, 2.0 + np.asarray(time_s))


def test_left_alone_it_stays_at_rest_where_the_source_simulated_it():
    seen = bench().observe(JOINTS, np.linspace(0.0, 0.5, 20))
    np.testing.assert_allclose(seen, np.tile(SIMULATED, (20, 1)), atol=0.02)
    assert np.ptp(seen, axis=0).max() < 1e-6


def test_it_is_held_at_one_hinge_swings_when_let_go_and_keeps_its_loop_closed():
    seen = released(bench(), -15.0, np.linspace(0.001, 2.0, 400))
    assert seen[0, 4] == pytest.approx(np.radians(-15.0), abs=0.015)
    assert np.ptp(seen[:, 4]) > 0.1
    assert np.max(loop_opening(seen)) < 1e-6


def test_cameras_find_the_angles_again_in_the_bodies_poses():
    made = bench()
    released(made, -15.0, [0.0])
    names = [f"{body}_{part}" for body in BODIES for part in ("qx", "qy", "qz", "qw")]
    time_s = np.linspace(2.0, 3.0, 30)
    quaternions = made.observe(names, time_s).reshape(30, 6, 4)
    hinges = {
        name: HingeAngle.model_validate(
            {"from": start, "to": end, "axis": [np.cos(np.radians(deg)), np.sin(np.radians(deg)), 0.0]}
        )
        for name, (start, end, deg) in HINGES.items()
    }
    result = OrientationAngles(BODIES, hinges, {}).of(quaternions)
    np.testing.assert_allclose(result, made.observe(JOINTS, time_s), atol=2e-6)


def test_a_restored_bench_goes_on_as_it_was():
    first, other = bench(seed=4, noise=1.0), bench(seed=5, noise=1.0)
    released(first, -15.0, [0.1])
    other.restore(json.loads(json.dumps(first.snapshot())))
    later = np.linspace(2.2, 2.6, 9)
    np.testing.assert_array_equal(first.observe(JOINTS, later), other.observe(JOINTS, later))


def test_friction_hidden_at_a_hinge_shortens_the_swing():
    time_s = np.linspace(1.0, 2.0, 100)
    free = np.ptp(released(bench(), -15.0, time_s)[:, 4])
    hidden = {"effect": "coulomb-friction", "site": "theta_3", "values": {"torque": 1e-3}}
    made = bench(hide=[hidden])
    assert np.ptp(released(made, -15.0, time_s)[:, 4]) < 0.8 * free
    assert made.truth()["hidden"][0]["site"] == "theta_3"


def test_what_is_hidden_nowhere_is_told():
    with pytest.raises(SpecError, match="no site 'theta_7'"):
        bench(hide=[{"effect": "coulomb-friction", "site": "theta_7"}])


def test_rest_period_and_decay_of_a_known_swing_are_found():
    time_s = np.linspace(0.0, 8.0, 2000)
    angle = -0.15 + 0.05 * np.exp(-0.3 * time_s) * np.cos(2 * np.pi * time_s / 0.42 + 0.7)
    result = swing(time_s, angle)
    assert (result.rest, result.decay, result.period) == pytest.approx((-0.15, 0.3, 0.42), rel=1e-6)
    assert (result.amplitude, result.noise) == pytest.approx((0.05, 0.0), abs=1e-8)


def test_a_trial_without_a_swing_is_no_period():
    time_s = np.linspace(0.0, 8.0, 2000)
    noise = np.random.default_rng(0).normal(0.0, 2e-3, (2000, 6))
    trial = FitTrial("trial 3", {}, 0, time_s, np.empty((2000, 0)), noise)
    with pytest.raises(
        FitError, match=r"trial 3, theta_5: after 2 s it swings by .* lost in noise of 0\.002 rad"
    ):
        swings_of(trial, 2.0)


def test_table_3_3_is_a_tenth_of_a_radian_away_and_joint_4_the_most(tmp_path):
    table = shipped_experiments() / "recordings" / "table-3-3"
    result = labrun.compare(table, model="six-bar", results=tmp_path)
    distances = result.comparison.distances()
    assert np.mean(list(distances.values())) == pytest.approx(0.0907, abs=0.005)
    assert max(distances, key=distances.get) == "theta_4"
    assert "over 6 channels: 0.0927" in result.to_text()
    assert "the largest is theta_4's" in result.to_text(200)
