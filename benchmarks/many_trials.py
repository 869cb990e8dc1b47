"""How long the diagnosis of 72 trials takes beside that of 18 of them, in one run.

    python benchmarks/many_trials.py [--workers 2]

The data: a position servo with an arm, 12 motions at 3 gains, 6 s at 100 Hz each, twice; scipy integrates them. The
model lacks dry friction that is greater at rest. The 18 are nine of the motions at one gain, twice.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.models import parse_model
from labrun.store import SignalInfo

MODEL = """
name   = "servo-arm"
states = ["angle", "rate"]
inputs = ["goal"]
[parameters]
inertia = { value = 0.0115, tolerance = 0.1, unit = "kg m^2" }
gravity = { value = 0.36, tolerance = 0.05, unit = "N m" }
damping = { value = 0.02, tolerance = "free", unit = "N m s/rad", lower = 0.0 }
back = { value = 0.012, tolerance = "free", unit = "s", lower = 0.0 }
[equations]
angle = "rate"
rate = "(gain_n_m_rad*(goal - angle - back*rate) + force.joint - damping*rate - gravity*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "gravity*sin(angle)"
[initial]
angle = 0.0
rate = 0.0
"""
MOTIONS = [(0.25 + 0.1 * (n % 6), 0.3 + 0.25 * (n // 3) + 0.05 * (n % 3)) for n in range(12)]
"""Amplitude in rad, frequency in Hz."""
GAINS_N_M_RAD = (3.0, 6.0, 12.0)
NOISE_RAD = 1e-3


def recorded(motions: Sequence[tuple[float, float]], gains: Sequence[float]) -> Dataset:
    """Return every motion at every gain, twice."""
    rng = np.random.default_rng(72)
    time_s, trials = np.arange(0.0, 6.0, 0.01), []
    for amplitude, frequency in motions:
        for gain in gains:
            goal, angle = course(amplitude, frequency, gain, time_s)
            condition = {"amplitude_rad": amplitude, "frequency_hz": frequency, "gain_n_m_rad": gain}
            for repeat in (1, 2):
                noisy = angle + NOISE_RAD * rng.standard_normal(len(angle))
                label = f"{frequency:.2f} Hz at {gain:g} N m/rad, repeat {repeat}"
                trials.append(FitTrial(label, condition, repeat, time_s, goal[:, None], noisy[:, None]))
    inputs, outputs = (SignalInfo("goal", "rad", "linear"),), (SignalInfo("angle", "rad", "linear"),)
    return Dataset("servo-arm", Path("servo-arm"), "recording", inputs, outputs, tuple(trials))


def course(
    amplitude: float, frequency: float, gain: float, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return goal and angle of the true arm."""

    def goal(t: float | np.ndarray) -> float | np.ndarray:
        return amplitude * np.sin(2 * np.pi * frequency * t)

    def slope(t: float, x: np.ndarray) -> list[float]:
        friction = (0.09 + 0.03 * np.exp(-((x[1] / 0.15) ** 2))) * np.tanh(x[1] / 0.01)
        drive = gain * (goal(t) - x[0] - 0.01 * x[1])
        return [x[1], float(drive - 0.03 * x[1] - friction - 0.35 * np.sin(x[0])) / 0.012]

    span = (float(time_s[0]), float(time_s[-1]))
    solution = solve_ivp(slope, span, [0.0, 0.0], "LSODA", time_s, rtol=1e-7, atol=1e-9, max_step=0.01)
    return np.asarray(goal(time_s)), solution.y[0]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    model, options = parse_model(MODEL, "servo-arm"), Options(workers=asked.workers)
    few, many = recorded(MOTIONS[:9], GAINS_N_M_RAD[:1]), recorded(MOTIONS, GAINS_N_M_RAD)
    diagnose_dataset(few, model, options)  # warms the compiled code
    seconds = []
    for dataset in (few, many):
        began, processor = time.perf_counter(), time.process_time()
        diagnosis = diagnose_dataset(dataset, model, options)
        seconds.append(time.perf_counter() - began)
        spent = time.process_time() - processor
        print(
            f"{len(dataset.trials)} trials: {seconds[-1]:.1f} s, {spent:.1f} s of processor time: {diagnosis.sentence}"
        )
    print(
        f"{len(many.trials) / len(few.trials):.0f} times the trials take {seconds[1] / seconds[0]:.1f} times as long"
    )


if __name__ == "__main__":
    main()
