"""Synthetic experiments: a model, an effect it does not know, noise, and a recalibration by scipy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap.averaging import averaged
from labrun.gap.noise import from_repeats, from_residual
from labrun.gap.where import Difference
from labrun.models import parse_model, prepare, simulate
from labrun.store import SignalInfo

JOINT = """
name = "joint"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia   = { value = 0.02, tolerance = 0.05, unit = "kg m^2" }
stiffness = { value = 1.0, unit = "N m/rad" }
damping   = { value = 0.02, unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
speed = { equation = "rate", unit = "rad/s" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "stiffness*angle"
[initial]
angle = 0.0
rate = 0.0
"""
MODEL = parse_model(JOINT, "joint.toml")
SUBSTEPS = 4
FREQUENCIES = (0.5, 0.8, 1.0, 1.3, 1.6)
SD = np.array([0.01, 0.05])


def time_and_torque(frequency_hz, *, seconds=6.0, rate_hz=60.0, amplitude=0.5):
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    return time_s, amplitude * np.sin(2 * np.pi * frequency_hz * time_s)[:, None]


def made(
    rng, effects=(), *, effects_at=None, frequencies=FREQUENCIES, repeats=3, sd=SD, model=MODEL, disturb=None,
    recalibrate=True, seconds=6.0, rate_hz=60.0,
):  # fmt: skip
    """Return the difference between a model and data in which it has effects (at some conditions only)."""
    trials = []
    for frequency in frequencies:
        time_s, torque = time_and_torque(frequency, seconds=seconds, rate_hz=rate_hz)
        there = effects if effects_at is None or frequency in effects_at else ()
        truth = simulate(model, time_s, torque, initial_state=[0.0, 0.0], effects=there, substeps=8).outputs
        if disturb is not None:
            truth = disturb(time_s, truth)
        for repeat in range(repeats):
            outputs = truth + sd * rng.standard_normal(truth.shape)
            trials.append(
                FitTrial(
                    f"f{frequency} r{repeat}", {"frequency_hz": frequency}, repeat, time_s, torque, outputs
                )
            )
    return compared(model, trials, recalibrate=recalibrate)


def compared(model, trials, *, recalibrate=True):
    """Return a model, recalibrated or not, beside trials."""
    inputs = tuple(SignalInfo(signal.name, signal.unit) for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    dataset = Dataset("case", Path("case"), "recording", inputs, outputs, tuple(trials))
    units = averaged(dataset, model)
    drives = tuple(prepare(model, trial.time_s, trial.inputs, SUBSTEPS) for trial in units.trials)
    start = [model.initial_state(trial.condition) for trial in units.trials]
    spread = np.std(np.concatenate([trial.outputs for trial in trials]), axis=0)

    def outputs_of(factors):
        return [
            simulate(
                model, unit.time_s, drive, parameters=model.values * factors,
                condition=unit.condition, initial_state=state,
            ).outputs
            for unit, drive, state in zip(units.trials, drives, start, strict=True)
        ]  # fmt: skip

    def residual_of(factors):
        pairs = zip(units.trials, outputs_of(factors), strict=True)
        return np.concatenate([((unit.outputs - output) / spread).ravel() for unit, output in pairs])

    factors, jacobian = np.ones(len(model.parameters)), None
    if recalibrate and len(factors):
        solution = least_squares(residual_of, factors)
        factors = solution.x
        jacobian = -solution.jac * np.tile(spread, len(solution.jac) // len(spread))[:, None]
    simulated = tuple(outputs_of(factors))
    residual = tuple(unit.outputs - output for unit, output in zip(units.trials, simulated, strict=True))
    members = [
        [member - output for member in unit.members]
        for unit, output in zip(units.trials, simulated, strict=True)
    ]
    noise = from_repeats(units, members) or from_residual(units, members)
    return Difference(
        model, units, noise, model.values * factors, (), tuple(start), drives, simulated, residual, jacobian
    )


def share_of(places, by, at):
    """Return the place of that name."""
    return next(location for location in places if location.by == by and location.at == at)


__all__ = [
    "FREQUENCIES",
    "JOINT",
    "MODEL",
    "SD",
    "compared",
    "made",
    "replace",
    "share_of",
    "time_and_torque",
]
