"""What is typical at a site: what effects are measured in."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labrun.fit import Dataset, FitTrial
from labrun.gap.averaging import averaged
from labrun.gap.candidates import site_scales
from labrun.gap.diagnose import diagnose_dataset
from labrun.gap.recalibration import stated_problem
from labrun.models import parse_model
from labrun.store import SignalInfo

from .benches import PENDULUM, FloatArray, among, logged, recorded

CONDITIONS = ((0.02, 0.6), (0.03, 0.9))
DATASET = recorded(conditions=CONDITIONS, repeats=1)


def scales(text):
    model = parse_model(text, "pendulum.toml")
    problem = stated_problem(model, averaged(DATASET, model))
    return site_scales(problem, problem.priors.stated)


def test_an_output_is_measured_in_nearly_the_largest_that_was_recorded_of_it():
    outputs = np.concatenate([trial.outputs for trial in DATASET.trials])
    assert scales(PENDULUM)["output", "angle"].signal == pytest.approx(np.percentile(np.abs(outputs), 99))


def test_a_site_whose_coordinate_nothing_depends_on_has_a_scale_all_the_same():
    whole = scales(PENDULUM)["joint", "hinge"]
    joint = scales(PENDULUM.replace('coordinate = "angle"', 'coordinate = "0"'))["joint", "hinge"]
    assert joint.rate == pytest.approx(whole.rate)
    assert joint.coordinate == pytest.approx(whole.rate * whole.time_s / (2 * np.pi))


FREE_AXIS = """
name = "axis"
states = ["angle", "rate"]
inputs = { torque = { unit = "N m" } }
[parameters]
inertia = { value = 9.0e-3, tolerance = 0.03, unit = "kg m^2", lower = 1e-6 }
damping = { value = 0.04, tolerance = "free", unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate = "(force.motor + torque - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.motor]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "torque"
drive = true
[initial]
angle = 0.0
rate = 0.0
"""
LINK = {"inertia": 4e-3, "stiffness": 12.0, "damping": 0.015}
"""Behind the transmission; the motor has what is left of 9e-3 kg m^2."""


@cache
def shaken() -> Dataset:
    """Return one long log of a motor that turns slowly a long way and is shaken; its link hangs on a spring."""
    time_s = np.arange(0.0, 10.0, 1 / 250)
    rng = np.random.default_rng(4)
    waves = [(0.2, 0.12)] + [(0.15, frequency_hz) for frequency_hz in np.arange(0.7, 12.0, 0.9)]
    torque = sum(
        size * np.sin(2 * np.pi * frequency_hz * time_s + rng.uniform(0, 2 * np.pi))
        for size, frequency_hz in waves
    )

    def slope(t: float, x: FloatArray) -> list[float]:
        spring = LINK["stiffness"] * (x[0] - x[2]) + LINK["damping"] * (x[1] - x[3])
        pushed = float(np.interp(t, time_s, torque)) - 0.04 * x[1] - spring
        return [x[1], pushed / (9.0e-3 - LINK["inertia"]), x[3], spring / LINK["inertia"]]

    moved = solve_ivp(slope, (0.0, 10.0), [0.0] * 4, t_eval=time_s, rtol=1e-8, atol=1e-10, max_step=4e-3)
    angle = moved.y[0] + 2e-3 * rng.standard_normal(len(time_s))
    trial = FitTrial("log", {}, 1, time_s, torque[:, None], angle[:, None])
    return logged(
        "axis", SignalInfo("torque", "N m", "linear"), SignalInfo("angle", "rad", "linear"), [trial]
    )


def test_a_free_axis_comes_round_slowly_and_is_accelerated_as_fast_as_it_is_shaken():
    model = parse_model(FREE_AXIS, "axis.toml")
    problem = stated_problem(model, averaged(shaken(), model))
    scale = site_scales(problem, problem.priors.stated)["joint", "motor"]
    assert scale.of("time") > 1.0
    assert 0.1 < scale.of("acceleration-time") < 0.8


def test_a_free_axis_takes_more_torque_than_what_would_keep_it_at_its_speed():
    model = parse_model(FREE_AXIS, "axis.toml")
    problem = stated_problem(model, averaged(shaken(), model))
    scale = site_scales(problem, problem.priors.stated)["joint", "motor"]
    asked = max(float(np.percentile(np.abs(trial.inputs), 99.0)) for trial in shaken().trials)
    assert scale.of("load") == pytest.approx(asked, rel=0.01)
    assert scale.of("load") > 2.0 * scale.of("force")


def test_a_transmission_that_gives_way_is_found_in_an_axis_that_goes_far():
    dataset = diagnose_dataset(
        shaken(),
        parse_model(FREE_AXIS, "axis.toml"),
        among("elastic-transmission", "coulomb-friction", "lag", "delay"),
    )
    (cause,) = dataset.causes
    assert str(cause.name) == "elastic-transmission at motor"
    period_s = np.sqrt(LINK["inertia"] / LINK["stiffness"])
    ratio = LINK["damping"] / (2.0 * np.sqrt(LINK["inertia"] * LINK["stiffness"]))
    for name, true in {"inertia": LINK["inertia"], "period": period_s, "damping_ratio": ratio}.items():
        if name in cause.values:  # the others are held
            assert cause.values[name].value == pytest.approx(true, rel=0.15)
    assert "period" in cause.values
