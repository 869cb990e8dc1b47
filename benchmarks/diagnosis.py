"""How long a diagnosis takes, beside one CMA-ES fit per model, on the same data in the same run.

    python benchmarks/diagnosis.py              # add --full-guard for the guard with all its fits (minutes)

The data: a driven pendulum with dry friction that its model lacks, 7 conditions of 6 s at 120 Hz, 3 repeats each: 21
trials. The diagnosis tries every effect of the library at every site, on withheld conditions, and looks where the gap
is. The other way is that of BAM (Duclusaud et al., "Extended friction models for the physics simulation of servo
actuators", 2024): a list of friction models, each fitted by CMA-ES to everything, the one of least error taken. Five
models are fitted, with 1000 evaluations each, on the same compiled simulation; BAM itself evaluates far more often.
"""

import argparse
import time
from pathlib import Path

import cma
import numpy as np

from labrun.effects import load_effect
from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.problem import Problem
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate, candidates, site_scales
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.recalibration import recalibrate
from labrun.models import Model, parse_model, simulate
from labrun.store import SignalInfo

MODEL = """
name = "driven-pendulum"
states = ["angle", "rate"]
inputs = ["torque"]
[parameters]
inertia   = { value = 1.2e-3, tolerance = 0.03,   unit = "kg m^2" }
gravity   = { value = 0.06,   tolerance = 0.03,   unit = "N m" }
stiffness = { value = 0.068,  tolerance = "free", unit = "N m/rad" }
damping   = { value = 1.0e-3, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate - gravity*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "gravity*cos(angle)"
[initial]
angle = 0.0
rate = 0.0
"""
TRUE = {"inertia": 1.22e-3, "gravity": 0.0612, "stiffness": 0.075, "damping": 1.3e-3}
DRIVES = ((0.02, 0.6), (0.03, 0.9), (0.04, 1.2), (0.03, 1.7), (0.05, 0.8), (0.02, 2.2), (0.04, 0.4))
FRICTION = (
    "coulomb-friction",
    "stribeck-friction",
    "load-dependent-friction",
    "presliding-friction",
    "hysteresis",
)
EVALUATIONS = 1000


def recorded(model: Model) -> Dataset:
    """Return the 21 trials."""
    rng = np.random.default_rng(1)
    friction = load_effect("coulomb-friction").attach("hinge", torque=0.006, transition_speed=0.05)
    time_s = np.arange(720) / 120.0
    trials = []
    for amplitude, frequency in DRIVES:
        torque = amplitude * np.sin(2 * np.pi * frequency * time_s)[:, None]
        angle = simulate(model, time_s, torque, parameters=TRUE, effects=[friction]).outputs
        condition = {"amplitude_n_m": amplitude, "frequency_hz": frequency}
        for repeat in (1, 2, 3):
            noisy = angle + 0.004 * rng.standard_normal(angle.shape)
            trials.append(
                FitTrial(f"{amplitude} N m, {frequency} Hz", condition, repeat, time_s, torque, noisy)
            )
    inputs, outputs = (SignalInfo("torque", "N m", "linear"),), (SignalInfo("angle", "rad", "linear"),)
    return Dataset("pendulum", Path("pendulum"), "recording", inputs, outputs, tuple(trials))


def by_cmaes(problem: Problem, z: np.ndarray, candidate: Candidate) -> float:
    """Fit one friction model by CMA-ES; return the sum of squares it ends at."""
    added = candidate.added_to(problem)
    start = np.concatenate([z[: problem.size], candidate.starts[0]])
    own = problem.own_states(z)
    low = np.where(np.isfinite(added.priors.lower), added.priors.lower, -10.0)
    high = np.where(np.isfinite(added.priors.upper), added.priors.upper, 10.0)
    settings = {"seed": 1, "verbose": -9, "maxfevals": EVALUATIONS, "bounds": [low, high]}
    fmin2 = cma.fmin2(
        lambda x: added.squares(np.concatenate([x, own])), np.clip(start, low, high), 0.1, settings
    )
    return float(fmin2[1].result.fbest)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full-guard", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    model = parse_model(MODEL, "driven-pendulum")
    dataset = recorded(model)
    options = Options(workers=asked.workers)
    diagnose_dataset(dataset, model, options)  # warms the compiled code
    began = time.perf_counter()
    diagnosis = diagnose_dataset(dataset, model, options)
    took = time.perf_counter() - began
    print(f"diagnosis, {len(diagnosis.candidates)} candidates, {len(dataset.trials)} trials: {took:.1f} s")
    print(f"    {diagnosis.sentence}")
    if asked.full_guard:
        began = time.perf_counter()
        diagnose_dataset(dataset, model, Options(workers=asked.workers, full_guard=True))
        print(f"diagnosis with the full guard: {time.perf_counter() - began:.1f} s")
    recalibration = recalibrate(model, averaged(dataset, model), np.random.default_rng(0), lambda _: None)
    scales = site_scales(recalibration.problem, recalibration.z)
    known = [
        candidate
        for candidate in candidates(recalibration.problem.model, scales)
        if candidate.name.effect in FRICTION
    ]
    began = time.perf_counter()
    ends = {
        candidate.name.effect: by_cmaes(recalibration.problem, recalibration.z, candidate)
        for candidate in known
    }
    took = time.perf_counter() - began
    best = min(ends, key=ends.__getitem__)
    print(
        f"CMA-ES, {len(ends)} friction models, {EVALUATIONS} evaluations each: {took:.1f} s; least error: {best}"
    )


if __name__ == "__main__":
    main()
