"""The driven joint: statics, resonance and energy in closed form, and what a person changes on the bench."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.driven_joint.scene import DrivenJoint
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from labrun import registry
from labrun.devices import Trajectory
from labrun.errors import SpecError

STIFFNESS, DAMPING, INERTIA, MOMENT, LEVER_M, G = 0.3, 2.5e-3, 2.5e-4, 3.0e-3, 0.08, 9.81
"""The numbers of the bench, written down once more."""


def bench(seed=0, **keys):
    return DrivenJoint({"noise": 0, "drag_n_m_s2": 0, **keys}, np.random.default_rng(seed))


def path(angles_rad, times_s):
    return Trajectory(("base",), np.array(times_s, float), np.array(angles_rad, float)[:, None])


def turned(made, angles_rad, times_s, time_s, signals=("angle", "horn")):
    made.observe(("angle",), np.zeros(1))
    made.drive("base", path(angles_rad, times_s), 1.0)
    return made.observe(signals, 1.0 + np.asarray(time_s))


def gravity(payload_g):
    return G * (MOMENT + 1e-3 * payload_g * LEVER_M)


def inertia(payload_g):
    return INERTIA + 1e-3 * payload_g * LEVER_M**2


@settings(max_examples=15, deadline=None)
@given(
    to_rad=st.floats(-0.7, 0.7), payload_g=st.floats(0.0, 80.0), up=st.sampled_from([1.0, -1.0]),
    strip_mm=st.sampled_from([12.5, 25.0, 40.0]), tilt=st.floats(-0.1, 0.1),
)  # fmt: skip
def test_at_rest_the_strips_torque_is_gravitys(to_rad, payload_g, up, strip_mm, tilt):
    made = bench(payload_g=payload_g, up=up, strip_mm=strip_mm, true_parameters={"tilt": tilt})
    angle, horn = turned(made, [0.0, to_rad], [0.0, 1.0], [30.0])[0]
    k = STIFFNESS * strip_mm / 25.0
    still = brentq(lambda a: k * (to_rad - a) - up * gravity(payload_g) * math.sin(a + tilt), -3.0, 3.0)
    assert horn == pytest.approx(to_rad, abs=1e-9)
    assert angle == pytest.approx(still, abs=1e-6)


@pytest.mark.parametrize(("up", "payload_g"), [(1.0, 0.0), (1.0, 40.0), (-1.0, 40.0)])
def test_let_go_by_a_small_jerk_it_swings_at_its_natural_frequency_and_dies_out_as_damping_says(
    up, payload_g
):
    time_s = np.arange(0.05, 1.5, 0.001)
    angle = turned(bench(payload_g=payload_g, up=up), [0.0, 0.01], [0.0, 0.001], time_s)[:, 0]
    swing = angle - STIFFNESS * 0.01 / (STIFFNESS + up * gravity(payload_g))
    squared = (STIFFNESS + up * gravity(payload_g)) / inertia(payload_g)
    decay = DAMPING / (2 * inertia(payload_g))
    crossings = time_s[1:][np.diff(np.sign(swing)) > 0]
    assert 1 / np.mean(np.diff(crossings)) == pytest.approx(
        math.sqrt(squared - decay**2) / (2 * math.pi), rel=3e-3
    )
    peaks = [
        swing[first:last].max() for first, last in zip([0, 300, 600], [300, 600, 900], strict=True)
    ]  # 0.3 s holds more than a cycle
    assert math.log(peaks[0] / peaks[2]) / 0.6 == pytest.approx(decay, rel=0.3)


def test_without_damping_and_with_the_horn_still_energy_stays():
    made = bench(true_parameters={"damping": 0.0})
    time_s = np.arange(0.3, 8.0, 0.001)
    angle = turned(made, [0.0, 0.5, 0.4], [0.0, 0.1, 0.2], time_s)[:, 0]
    rate = np.gradient(angle, 0.001)
    energy = (
        0.5 * inertia(40.0) * rate**2 + 0.5 * STIFFNESS * (angle - 0.4) ** 2 - gravity(40.0) * np.cos(angle)
    )
    assert np.ptp(energy[5:-5]) < 2e-3 * 0.5 * inertia(40.0) * np.max(rate**2)


def test_a_fast_motion_with_friction_is_that_of_an_independent_integration():
    time_s = np.linspace(0.0, 2.0, 150)
    times = np.arange(0.0, 2.0, 0.005)
    message = 0.3 * np.sin(2 * np.pi * 2.0 * times) * np.clip(2 * times, 0, 1)

    rates = np.diff(message) / 0.005

    def slope(t, x):
        base, base_rate = np.interp(t, times, message), rates[min(int(t / 0.005), len(rates) - 1)]
        torque = STIFFNESS * (base - x[0]) + DAMPING * (base_rate - x[1]) - gravity(40.0) * math.sin(x[0])
        return [
            x[1],
            (torque - 3e-3 * math.tanh(x[1] / 0.02) - 2e-6 * x[1] * abs(x[1])) / inertia(40.0),
        ]

    solved = solve_ivp(slope, (0.0, 2.0), [0.0, 0.0], max_step=1e-3, rtol=1e-7, atol=1e-9, t_eval=time_s)
    made = bench(friction_mn_m=3.0, drag_n_m_s2=2e-6)
    result = turned(made, message, times, time_s)[:, 0]
    np.testing.assert_allclose(result, solved.y[0], atol=5e-4)


def test_the_pose_that_the_cameras_see_is_that_of_the_angle():
    seen = turned(bench(), [0.0, 0.6], [0.0, 1.0], [30.0], ("angle", "arm_qy", "arm_qw", "arm_x", "horn_qy"))
    angle, qy, qw, x, horn_qy = seen[0]
    assert 2 * math.atan2(qy, qw) == pytest.approx(angle)
    assert x == pytest.approx(0.2 - 0.05 * math.sin(angle))
    assert 2 * math.asin(horn_qy) == pytest.approx(0.6)


def test_a_person_changes_payload_strip_and_orientation_and_nothing_jumps():
    made = bench()
    turned(made, [0.0, 0.4], [0.0, 1.0], [30.0])
    before = made.observe(("angle",), np.array([31.1]))[0, 0]
    made.arrange({"f": 0.3, "payload_g": 60, "strip_mm": 50, "up": -1})
    assert made.truth()["mounted"] == {"payload_g": 60.0, "up": -1.0, "strip_mm": 50.0}
    at_once, later = made.observe(("angle",), np.array([31.103, 61.0]))[:, 0]
    assert at_once == pytest.approx(before, abs=1e-3)
    assert later > 0.4 > before
    made.arrange({"f": 0.9})
    assert made.truth()["mounted"]["payload_g"] == 60.0


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ({"payload_g": 500}, "payload_g = 500"),
        ({"up": 0.5}, "up = 0.5"),
        ({"strip_mm": 0}, "strip_mm = 0"),
        ({"payload_g": 190, "strip_mm": 10, "up": -1}, "tips over"),
    ],
)
def test_what_the_bench_cannot_do_is_refused(condition, message):
    with pytest.raises(SpecError, match=message):
        bench().arrange(condition)


def test_every_run_is_a_setup_of_its_own_and_its_seed_says_which():
    def parameters(seed, **keys):
        return DrivenJoint(keys, np.random.default_rng(seed)).truth()["parameters"]

    assert parameters(1) == parameters(1)
    spread = np.std([parameters(seed)["stiffness"] for seed in range(200)])
    assert spread == pytest.approx(0.02 * STIFFNESS, rel=0.2)
    assert parameters(1)["drag"] > 0
    assert parameters(1, as_modelled=True)["drag"] == 0


def test_true_parameters_are_what_they_are_said_to_be_and_unknown_ones_are_refused():
    made = bench(true_parameters={"tilt": 0.05}, parameters={"stiffness": 0.1})
    assert made.truth()["parameters"]["tilt"] == 0.05
    assert made.truth()["parameters"]["stiffness"] == pytest.approx(1.1 * STIFFNESS)
    with pytest.raises(SpecError, match=r"true_parameters(.|\n)*'tlit'"):
        bench(true_parameters={"tlit": 0.05})


@pytest.mark.parametrize(
    ("effect", "site"),
    [
        ("coulomb-friction", "hinge"),
        ("rest-offset", "hinge"),
        ("lag", "base"),
        ("bias", "angle"),
        ("gain-error", "horn"),
    ],
)
def test_effects_hide_in_the_joint_in_the_servo_and_in_the_cameras(effect, site):
    times = np.linspace(0.1, 3.0, 50)
    plain = turned(bench(), [0.0, 0.5, -0.5], [0.0, 1.0, 2.0], times)
    made = bench(hide=[{"effect": effect, "site": site}])
    assert [hidden["effect"] for hidden in made.truth()["hidden"]] == [effect]
    change = np.abs(turned(made, [0.0, 0.5, -0.5], [0.0, 1.0, 2.0], times) - plain).max(axis=0)
    assert change.max() > 1e-3
    assert (change[1] > 1e-9) == (site in ("base", "horn"))


def test_a_stored_bench_continues_to_the_last_bit():
    later = 3.0 + np.arange(0.0, 3.0, 0.013)
    keys = {"hide": [{"effect": "lag", "site": "base"}, {"effect": "lag", "site": "angle"}]}

    def moved():
        made = DrivenJoint(keys, np.random.default_rng(4))
        turned(made, [0.0, 0.4, -0.4], [0.0, 1.0, 5.0], [1.9])
        made.arrange({"payload_g": 60, "up": -1})
        return made

    made, other = moved(), DrivenJoint(keys, np.random.default_rng(9))
    other.restore(json.loads(json.dumps(made.snapshot())))
    signals = tuple(made.signals)
    np.testing.assert_array_equal(other.observe(signals, later), moved().observe(signals, later))
    assert other.truth() == made.truth()


def test_it_is_found_under_its_name():
    assert registry.load("labrun.scenes", "driven-joint") is DrivenJoint
