"""The hinge bench against an independent integration of the corrected eq. (3.5)."""

from pathlib import Path

import numpy as np
import pytest
from labrun_plugins.rigs.hinge.scene import HingeBench
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit
from simulated_bench import line

from labrun.errors import SpecError
from labrun.models import load_model

TIME_S = 2.0 + np.arange(0.0, 5.0, 1 / 360)


def _released(settings, seed=0, angle_deg=40.0, condition=None):
    bench = HingeBench(settings, np.random.default_rng(seed))
    bench.arrange(condition or {})
    bench.observe(["hinge"], np.array([0.0]))
    bench.drive("hinge", line("hinge", [0.0, angle_deg, angle_deg], [0.0, 1.0, 2.0]), 0.0)
    return bench


def _expected(truth, angle_deg=40.0):
    p, drag = truth["parameters"], truth["built_in"][0]["values"]["coefficient"]

    def slope(t, x):
        angle, rate = x
        torque = -p["stiffness"] * angle - p["damping"] * rate - p["gravity_torque"] * np.sin(angle)
        return [rate, (torque - drag * abs(rate) * rate) / p["inertia"]]

    solution = solve_ivp(
        slope, (0, 5), [np.radians(angle_deg), 0.0], rtol=1e-10, atol=1e-12, dense_output=True
    )
    return solution.sol(TIME_S - 2.0)[0]


@pytest.mark.parametrize("condition", [{}, {"width_mm": 30.0, "length_mm": 1.0, "area_cm2": 60.0}])
def test_free_decay_is_that_of_the_equation(condition):
    bench = _released({"noise": 0}, condition=condition)
    angle = bench.observe(["hinge"], TIME_S)[:, 0]
    np.testing.assert_allclose(angle, _expected(bench.truth()), atol=2e-4)


def test_stiffness_and_damping_are_those_of_the_corrected_maps():
    truth = HingeBench({"noise": 0}, np.random.default_rng(0)).truth()
    w, length, a = 0.05, 0.00175, 43e-4
    k = 762.5397 * length**2 - 7.5305 * length - 1.4444 * w**2 + 0.4298 * w + 0.0073
    b = (
        -0.8565 * a**2
        + 0.0129 * a
        + 2.0822 * length**2
        - 0.0227 * length
        + 0.0408 * w**2
        - 0.0023 * w
        + 5.0855e-5
    )
    assert truth["parameters"]["stiffness"] == pytest.approx(k)
    drag = truth["built_in"][0]["values"]["coefficient"]
    p = truth["parameters"]
    omega = np.sqrt((p["stiffness"] + p["gravity_torque"]) / p["inertia"])
    # The map's b is the total: what linear damping and drag together take out of a swing of 20 degrees.
    total = p["damping"] + 8 / (3 * np.pi) * drag * omega * np.radians(20)
    assert total == pytest.approx(b)
    assert p["damping"] > 0.95 * b
    without = HingeBench({"noise": 0, "drag_coefficient": 0}, np.random.default_rng(0)).truth()
    assert without["parameters"]["damping"] == pytest.approx(b)


def test_the_body_is_the_one_that_the_shipped_model_describes():
    truth = HingeBench({"noise": 0}, np.random.default_rng(0)).truth()["parameters"]
    model = load_model(Path(__file__).parents[3] / "experiments" / "models" / "hinge-pendulum.toml")
    for parameter in model.parameters:
        assert truth[parameter.name] == pytest.approx(parameter.value, rel=0.03)


@pytest.mark.parametrize("angle_deg", [10, 50])
def test_a_linear_fit_finds_stiffness_and_damping_and_its_residual_shows_the_drag(angle_deg):
    bench = _released({"noise": 0}, angle_deg=angle_deg)
    angle = bench.observe(["hinge"], TIME_S)[:, 0]
    p = bench.truth()["parameters"]

    def swing(_, stiffness, damping):
        def slope(t, x):
            torque = -stiffness * x[0] - damping * x[1] - p["gravity_torque"] * np.sin(x[0])
            return [x[1], torque / p["inertia"]]

        start = [np.radians(angle_deg), 0.0]
        return solve_ivp(slope, (0, 5), start, t_eval=TIME_S - 2.0, rtol=1e-6, atol=1e-8).y[0]

    (stiffness, damping), _ = curve_fit(swing, TIME_S, angle, p0=[0.0143, 4.4e-5])
    assert stiffness == pytest.approx(0.0143, rel=0.02)
    assert damping == pytest.approx(4.4e-5, rel=0.05)
    left = np.abs(angle - swing(None, stiffness, damping)).max()
    assert 0.0005 * np.radians(angle_deg) < left < 0.02 * np.radians(angle_deg)


def test_the_body_is_held_until_its_motion_ends():
    bench = _released({})
    held = bench.observe(["hinge"], np.linspace(1.0, 1.99, 50))[:, 0]
    np.testing.assert_allclose(held, np.radians(40.0))


def test_the_pose_turns_about_the_y_axis_and_keeps_its_distance_from_the_pivot():
    bench = _released({"noise": 0})
    names = ["arm_x", "arm_y", "arm_z", "arm_qx", "arm_qy", "arm_qz", "arm_qw", "hinge"]
    pose = bench.observe(names, TIME_S)
    distance = np.hypot(pose[:, 0] - 0.2, pose[:, 2] - 1.1)
    np.testing.assert_allclose(distance, distance[0], rtol=1e-3)
    np.testing.assert_allclose(2 * np.arctan2(pose[:, 4], pose[:, 6]), pose[:, 7], atol=1e-4)
    assert np.all(pose[:, [1, 3, 5]] == 0)


def test_setups_scatter_like_the_published_repeats():
    values = np.array([
        [HingeBench({}, np.random.default_rng(seed)).truth()["parameters"][name] for name in ("stiffness", "damping")]
        for seed in range(300)
    ])  # fmt: skip
    spread = values.std(axis=0) / values.mean(axis=0)
    assert spread == pytest.approx([0.023, 0.032], rel=0.15)


def test_releases_of_one_setup_differ_a_little():
    bench = _released({})
    first = bench.observe(["hinge"], TIME_S)[:, 0]
    bench.drive("hinge", line("hinge", [0.0, 40.0, 40.0], [0.0, 1.0, 2.0]), 20.0)
    second = bench.observe(["hinge"], TIME_S + 20.0)[:, 0]
    difference = np.abs(first - second).max()
    assert 1e-4 < difference < 0.02
    releases = bench.truth()["releases"]
    assert [release["time_s"] for release in releases] == pytest.approx([2.0, 22.0], abs=0.002)
    assert releases[0]["stiffness"] != releases[1]["stiffness"]
    assert releases[0]["stiffness"] == pytest.approx(releases[1]["stiffness"], rel=0.01)
    assert releases[0]["damping"] == pytest.approx(releases[1]["damping"], rel=0.05)


def test_another_specimen_is_another_setup_and_its_own_releases_are_one():
    bench = HingeBench({}, np.random.default_rng(3))
    factors = []
    for width_mm in (50.0, 30.0, 30.0, 50.0):
        bench.arrange({"width_mm": width_mm})
        plain = HingeBench({"noise": 0}, np.random.default_rng(0))
        plain.arrange({"width_mm": width_mm})
        parameters, nominal = bench.truth()["parameters"], plain.truth()["parameters"]
        factors.append([parameters[name] / nominal[name] for name in ("stiffness", "damping")])
    assert factors[1] == factors[2]
    assert len({tuple(factor) for factor in factors}) == 3


def test_setups_of_changed_specimens_scatter_like_the_published_repeats():
    bench = HingeBench({}, np.random.default_rng(0))
    values = []
    for _ in range(300):
        bench.arrange({"width_mm": 30.0})
        bench.arrange({"width_mm": 50.0})
        values.append([bench.truth()["parameters"][name] for name in ("stiffness", "damping")])
    spread = np.std(values, axis=0) / np.mean(values, axis=0)
    assert spread == pytest.approx([0.023, 0.032], rel=0.15)


def test_a_bench_taken_back_after_a_change_of_specimen_goes_on_the_same():
    condition = {"width_mm": 30.0}
    bench = _released({}, seed=4, condition=condition)
    bench.observe(["hinge"], np.array([2.5]))
    again = HingeBench({}, np.random.default_rng(9))
    again.restore(bench.snapshot())
    for recorded in (bench, again):
        recorded.arrange(condition)  # the same specimen: stays as it hangs
        recorded.observe(["hinge"], np.array([3.0]))
        recorded.arrange({"width_mm": 20.0})
    assert bench.truth() == again.truth()
    (release,) = bench.truth()["releases"]
    assert release["stiffness"] == pytest.approx(0.00805, rel=0.1)  # that of the 30 mm hinge it was


def test_a_hidden_effect_works_on_the_bench_and_is_told_by_its_truth():
    hidden = {"effect": "coulomb-friction", "site": "hinge", "values": {"torque": 1e-3}}
    with_friction = _released({"noise": 0, "hide": [hidden]})
    without = _released({"noise": 0})
    late = TIME_S[-300:]
    assert np.abs(without.observe(["hinge"], late)).max() > 5 * np.ptp(with_friction.observe(["hinge"], late))
    (message,) = with_friction.truth()["hidden"]
    assert (message["effect"], message["site"], message["values"]["torque"]) == (
        "coulomb-friction",
        "hinge",
        1e-3,
    )


def test_a_parameter_error_is_relative():
    plain = HingeBench({"noise": 0}, np.random.default_rng(0)).truth()["parameters"]["stiffness"]
    other = HingeBench({"noise": 0, "parameters": {"stiffness": 0.02}}, np.random.default_rng(0)).truth()
    assert other["parameters"]["stiffness"] == pytest.approx(1.02 * plain)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"hide": [{"effect": "coulomb-friction", "site": "elbow"}]},
            "no site 'elbow'",
        ),
        ({"hide": [{"effect": "delay", "site": "hinge"}]}, "not at a joint site"),
        ({"hide": [{"effect": "coulomb-frction", "site": "hinge"}]}, "coulomb-frction"),
        ({"parameters": {"stifness": 0.1}}, "no parameter 'stifness'"),
        ({"widht_mm": 3.0}, "widht_mm"),
    ],
)
def test_what_a_bench_cannot_be_told_is_refused_by_name(settings, words):
    with pytest.raises(SpecError, match=words):
        HingeBench(settings, np.random.default_rng(0))
