"""Plants that are unstable in open loop: held on course by what was measured, so that causes can be found."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gap.benches import pendulum, recorded
from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap import Options, diagnose_dataset
from labrun.gap.on_course import kept_on_course
from labrun.models import Model, observed, parse_model, simulate
from labrun.store import SignalInfo

STICK = """
name = "stick"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia = { value = 0.0103, tolerance = 0.05, unit = "kg m^2" }
weight  = { value = 0.41, tolerance = 0.05, unit = "N m" }
damping = { value = 0.01, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.pivot + weight*sin(angle) - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.pivot]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = "free"
rate = "free"
"""
"""Balanced upside down: what differs grows e-fold in 0.16 s."""


def stick() -> Model:
    return parse_model(STICK, "stick.toml")


def balanced(friction: float, seconds: float = 8.0) -> Dataset:
    """Return three trials under feedback, whose torque alone is recorded beside the angle."""
    rng, trials = np.random.default_rng(3), []
    for number, frequency in enumerate((0.4, 0.7, 1.1)):

        def torque(t: float, x: np.ndarray, frequency: float = frequency) -> float:
            wanted = 0.15 * np.sin(2 * np.pi * frequency * t)
            return float(2.0 * (wanted - x[0]) - 0.12 * x[1])

        def slope(t: float, x: np.ndarray, torque: object = torque) -> list[float]:
            rub = friction * np.tanh(x[1] / 0.01)
            return [x[1], (torque(t, x) - rub + 0.4 * np.sin(x[0]) - 0.02 * x[1]) / 0.01]  # type: ignore[operator]

        time_s = np.arange(0.0, seconds, 0.01)
        x = solve_ivp(
            slope, (0.0, seconds), [0.05, 0.0], t_eval=time_s, rtol=1e-8, atol=1e-10, max_step=0.01
        ).y
        inputs = np.array([torque(t, state) for t, state in zip(time_s, x.T, strict=True)])[:, None]
        outputs = (x[0] + rng.normal(0.0, 5e-4, len(time_s)))[:, None]
        trials.append(FitTrial(f"run {number}", {"run": float(number)}, 1, time_s, inputs, outputs))
    torques, angles = (SignalInfo("torque", "N m", "linear"),), (SignalInfo("angle", "rad", "linear"),)
    return Dataset("stick", Path("stick"), "recording", torques, angles, tuple(trials))


def test_an_observer_without_gain_is_the_model_itself() -> None:
    model, trial = pendulum(), recorded(repeats=1).trials[0]
    held = observed(model, np.zeros((2, 1)), trial.condition)
    alone = simulate(model, trial.time_s, trial.inputs, condition=trial.condition, substeps=2)
    both = np.column_stack([trial.inputs, trial.outputs])
    jointly = simulate(held, trial.time_s, both, condition=trial.condition, substeps=2)
    np.testing.assert_array_equal(jointly.outputs, alone.outputs)


def test_a_plant_that_hangs_is_simulated_as_it_is() -> None:
    data, model = recorded(repeats=1), pendulum()
    assert kept_on_course(data, model) == (data, model, "")


def test_a_balanced_plant_follows_what_was_measured_of_it() -> None:
    data, model, message = kept_on_course(balanced(0.0), stick())
    assert "unstable in open loop" in message
    assert [signal.name for signal in data.inputs] == ["torque", "angle_measured"]
    assert "angle" not in [location.name for location in model.places if location.kind == "output"]
    true = model.with_values({"inertia": 0.01, "weight": 0.4, "damping": 0.02})
    for trial in data.trials:
        given = simulate(
            true, trial.time_s, trial.inputs, condition=trial.condition, initial_state=[0.05, 0.0]
        )
        later = trial.time_s > 2.0
        assert np.sqrt(np.mean(np.square(given.outputs - trial.outputs)[later])) < 3 * 5e-4


@pytest.mark.slow
def test_dry_friction_of_a_balanced_stick_is_found() -> None:
    dataset = diagnose_dataset(balanced(0.02), stick(), Options(places=False))
    assert [str(cause.name) for cause in dataset.causes] == ["coulomb-friction at pivot"]
    low, high = dataset.causes[0].values["torque"].low, dataset.causes[0].values["torque"].high
    assert low < 0.02 < high
    assert dataset.causes[0].values["torque"].value == pytest.approx(0.02, rel=0.1)
    assert (
        dataset.rest.predictable is None
    )  # its simulated motion follows the noise, which would predict itself
