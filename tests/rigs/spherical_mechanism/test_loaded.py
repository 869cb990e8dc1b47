"""The larger mechanism under load: its path, what its play, weight and load do, and its memory."""

import numpy as np
import pytest
from labrun_plugins.rigs.spherical_mechanism.kinematics import inverse, rotation
from labrun_plugins.rigs.spherical_mechanism.loaded_scene import SpmLoad
from labrun_plugins.rigs.spherical_mechanism.spiral import Spiral, servo_angles_deg
from scipy.spatial.transform import Rotation

from labrun.devices import Trajectory
from labrun.experiment import ObjectiveTable
from labrun.objectives import TrialSignals, make_objective
from labrun.signals import Signal

PLAIN = {"play_deg": 0.0, "offset_deg": (0.0, 0.0)}


def bench(**settings):
    return SpmLoad({**PLAIN, **settings}, np.random.default_rng(0))


def held(scene, servos_deg, until_s=3.0):
    scene.observe(["theta_1"], np.array([0.0]))
    for joint, angle in zip(scene.joints, servos_deg, strict=True):
        scene.drive(joint, Trajectory((joint,), np.zeros(1), np.array([[np.radians(angle)]])), 0.0)
    return np.degrees(scene.observe(["theta_1", "theta_2"], np.array([until_s]))[0])


def test_the_inverse_of_the_path_is_that_of_the_kinematics():
    spiral = Spiral({}, {})
    for time_s in np.linspace(0.0, 30.0, 41):
        w, x, y, z = spiral(time_s)
        turned = Rotation.from_quat([x, y, z, w]).as_matrix()
        first, second = inverse(turned[:, 2])
        np.testing.assert_allclose(servo_angles_deg((w, x, y, z)), np.degrees([first, second]), atol=1e-9)
        np.testing.assert_allclose(turned, rotation(first, second), atol=1e-9)


def test_the_path_leans_out_to_thirty_degrees_comes_back_and_closes():
    spiral = Spiral({}, {})
    lean = [2 * np.arccos(spiral(t)[0]) for t in np.linspace(0, 30, 301)]
    assert np.degrees(max(lean)) == pytest.approx(30.0, abs=3.0)
    np.testing.assert_allclose(spiral(30.0), spiral(0.0), atol=1e-12)


def test_it_goes_a_fifth_too_far_by_its_own_weight():
    result = held(bench(), (5.0, -5.0))
    np.testing.assert_allclose(result, [6.0, -6.0], rtol=0.005)


def test_a_load_pulls_the_axes_aside_opposite_ways():
    loaded = bench(load_g=100.0)
    np.testing.assert_allclose(held(loaded, (0.0, 0.0)), [5.9, -5.9], rtol=0.01)


def test_a_load_comes_and_goes_when_the_condition_says():
    scene = bench()
    scene.arrange({"load_g": 100.0, "load_from_s": 2.0, "load_to_s": 4.0})
    scene.observe(["load"], np.array([0.0]))
    scene.begin(1.0)
    load = scene.observe(["load"], np.array([0.5, 2.9, 3.1, 4.9, 5.1]))[:, 0]
    np.testing.assert_allclose(load, [0.0, 0.0, 0.1, 0.1, 0.0])


def test_play_leaves_the_horn_where_it_was_until_it_is_used_up():
    with_play = bench(play_deg=1.6)
    np.testing.assert_allclose(held(with_play, (1.5, 5.0)), [0.0, 1.2 * 3.4], atol=0.02)


def test_a_resumed_bench_goes_on_exactly():
    scene = bench(load_g=80.0, moving=1.0, play_deg=1.6)
    held(scene, (10.0, -4.0), until_s=1.0)
    scene.begin(1.0)
    again = bench(load_g=80.0, moving=1.0, play_deg=1.6)
    again.restore(scene.snapshot())
    times = np.linspace(1.0, 3.0, 50)
    signals = list(scene.signals)
    np.testing.assert_array_equal(scene.observe(signals, times), again.observe(signals, times))


def trial_of(angle_deg):
    """A trial whose end-effector is turned about x by so much more than it should be, as a function of time."""
    time_s = np.arange(0.0, 20.0, 0.05)
    half = np.radians(angle_deg(time_s)) / 2
    numbers = {"qw": np.cos(half), "qx": np.sin(half), "qy": 0 * half, "qz": 0 * half}
    signals = {f"loop.pose_feedback_{part}": Signal(time_s, values, "1") for part, values in numbers.items()}
    for part, value in (("qw", 1.0), ("qx", 0.0), ("qy", 0.0), ("qz", 0.0)):
        signals[f"loop.pose_reference_{part}"] = Signal(time_s, np.full_like(time_s, value), "1")
    command = Trajectory(("a",), np.zeros(1), np.zeros((1, 1)))
    return TrialSignals(signals, command, 0.0, 20.0)


def objective(**keys):
    return make_objective("off", ObjectiveTable.model_validate({"loop": "pose", **keys}))


def test_the_error_is_the_mean_over_the_three_euler_angles():
    signals = trial_of(lambda t: np.where(t < 10, 3.0, -6.0))
    assert objective(plugin="euler-error", to_s=10)(signals) == pytest.approx(1.0)
    assert objective(plugin="euler-error")(signals) == pytest.approx(1.5)


def test_recovery_ends_when_a_whole_window_is_steady_again():
    signals = trial_of(lambda t: np.where((t > 5) & (t < 9), 30.0, 3.0))
    recovery = objective(plugin="recovery-time", at_s=5, from_s=12, window_s=2.0)
    assert recovery(signals) == pytest.approx(4.0 + 1.9, abs=0.15)
    assert recovery.remark(signals) == ""


def test_what_never_recovers_says_so_beside_the_rest_of_the_recording():
    signals = trial_of(lambda t: np.where((t > 5) & (t < 9), 30.0, 3.0))
    recovery = objective(plugin="recovery-time", at_s=5, from_s=0, to_s=4, factor=0.5)
    assert recovery(signals) == pytest.approx(15.0)
    assert "not recovered" in recovery.remark(signals)
    assert "0.5 deg" in recovery.remark(signals)
