"""A law for what a model lacks: labrun's regression in integral form beside pysindy, on the same data.

    pip install pysindy
    python benchmarks/rest_law.py [--silverbox FOLDER]

The data: a pendulum on a hinge whose drag grows with the third power of its rate, which no effect of the library has
and which is 2e-5 N m s^3/rad^3; four swings of 3 s at 120 Hz, with noise of the angle from 0.2 to 10 mrad. labrun knows
the pendulum but for 2 % of its parameters, fits those, and regresses what is left. pysindy gets angle and rate (by its
smoothed differences), polynomials of both up to the third power, and sparse regression (STLSQ on normalised columns) of
the rate's derivative: of 13 thresholds the sparsest that predicts a withheld trial's derivative to within 0.002 of the
best score. The linear part of what it finds is the pendulum's own. Its weak form (for PDEs) was not tried.
--silverbox does the same on a real oscillator, whose cubic spring is published.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from labrun.app.question import ask
from labrun.fit import Dataset, FitTrial
from labrun.gap.averaging import averaged
from labrun.gap.recalibration import recalibrate
from labrun.gap.rest_law import explain_rest
from labrun.models import Model, parse_model
from labrun.store import SignalInfo

INERTIA, GRAVITY, STIFFNESS, DAMPING, DRAG = 1.2e-3, 0.06, 0.0686, 2.886e-4, 2e-5
MODEL = """
name = "hinge"
states = ["angle", "rate"]
[parameters]
inertia        = { value = 1.22e-3, tolerance = 0.03,   unit = "kg m^2" }
gravity_torque = { value = 0.0612,  tolerance = 0.03,   unit = "N m" }
stiffness      = { value = 0.067,   tolerance = "free", unit = "N m/rad" }
damping        = { value = 2.9e-4,  tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate  = "(force.hinge - stiffness*angle - damping*rate - gravity_torque*sin(angle)) / inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
[initial]
angle = "free"
rate = 0.0
"""


def swings(noise_rad: float) -> Dataset:
    """Return four swings by scipy."""
    rng = np.random.default_rng(1)
    time_s = np.arange(361) / 120.0

    def derivative(_: float, x: np.ndarray) -> list[float]:
        torque = -STIFFNESS * x[0] - DAMPING * x[1] - GRAVITY * np.sin(x[0]) - DRAG * x[1] ** 3
        return [x[1], torque / INERTIA]

    trials = []
    for release in (0.3, 0.6, 0.9, 1.2):
        solved = solve_ivp(
            derivative, (0, 3), [release, 0.0], method="DOP853", t_eval=time_s, rtol=1e-9, atol=1e-11
        )
        angle = solved.y[0] + noise_rad * rng.standard_normal(len(time_s))
        none = np.empty((len(time_s), 0))
        trials.append(FitTrial(f"{release} rad", {"release": release}, 1, time_s, none, angle[:, None]))
    return Dataset("swings", Path("swings"), "recording", (), (SignalInfo("angle", "rad"),), tuple(trials))


def by_labrun(model: Model, data: Dataset, term: str) -> str:
    """Return the terms and the coefficient of one of them, in SI."""
    begin = time.perf_counter()
    recalibrated = recalibrate(model, averaged(data, model), np.random.default_rng(0), lambda _: None)
    law = explain_rest(recalibrated.problem, recalibrated.z, recalibrated.noise, np.random.default_rng(0))
    took = time.perf_counter() - begin
    if law is None or not law.terms:
        return f"no law ({took:.1f} s)"
    ones = {"q": 1.0, "rate": 1.0, "signal": 1.0, "abs": abs, "tanh": np.tanh}
    messages = [
        (other.formula, other.size * eval(other.formula.replace("^", "**"), ones)) for other in law.terms
    ]
    return f"{', '.join(f'{value:.4g} {formula}' for formula, value in messages)} ({took:.1f} s; looked for: {term})"


def by_pysindy(data: Dataset, factor: float) -> str:
    """Return the terms beyond the linear part that pysindy finds for the rate's derivative, times a factor."""
    import pysindy

    begin = time.perf_counter()
    times = [trial.time_s - trial.time_s[0] for trial in data.trials]
    slope = pysindy.SmoothedFiniteDifference()
    states = [
        np.column_stack([trial.outputs[:, 0], slope(trial.outputs[:, :1], t)[:, 0]])
        for trial, t in zip(data.trials, times, strict=True)
    ]
    inputs = [trial.inputs for trial in data.trials] if data.inputs else None
    size = np.std(np.concatenate(states), axis=0)
    drive = None if inputs is None else [signal / np.std(np.concatenate(inputs)) for signal in inputs]
    scaled = [state / size for state in states]

    def fitted(threshold: float) -> tuple[float, int, pysindy.SINDy]:
        """Return the score on the trial that is withheld, the number of terms, and the model of all trials."""
        scores = []
        for chosen in ([0, 1, 3], [0, 1, 2, 3]):
            model = pysindy.SINDy(
                optimizer=pysindy.STLSQ(threshold=threshold, normalize_columns=True),
                feature_library=pysindy.PolynomialLibrary(degree=3),
                differentiation_method=slope,
            )
            part = None if drive is None else [drive[index] for index in chosen]
            model.fit([scaled[index] for index in chosen], t=[times[index] for index in chosen], u=part)
            withheld = None if drive is None else drive[2]
            scores.append(model.score(scaled[2], t=times[2], u=withheld))
        return scores[0], int(np.count_nonzero(model.coefficients()[1])), model

    scan = [fitted(threshold) for threshold in np.geomspace(0.05, 500.0, 13)]
    best = max(score for score, _, _ in scan)
    model = min((entry for entry in scan if entry[0] > best - 0.002), key=lambda entry: entry[1])[2]
    values = model.coefficients()[1] * size[1] * factor
    names = model.get_feature_names()
    messages = []
    for name, value in zip(names, values, strict=True):
        powers = [_power(name, "x0"), _power(name, "x1")]
        if abs(value) > 0 and name not in ("x0", "x1", "u0"):
            messages.append(f"{value / size[0] ** powers[0] / size[1] ** powers[1]:.4g} {name}")
    return f"{', '.join(messages) or 'linear alone'} ({time.perf_counter() - begin:.1f} s)"


def _power(name: str, state: str) -> int:
    factors = [part.partition("^") for part in name.split()]
    return sum(int(power or 1) for base, _, power in factors if base == state)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--silverbox", type=Path, metavar="FOLDER", help="the recording of that name")
    given = parser.parse_args()
    model = parse_model(MODEL, "hinge.toml")
    for noise in (2e-4, 2e-3, 1e-2):
        data = swings(noise)
        print(f"noise {1e3 * noise:g} mrad; truth {-DRAG:g} rate^3")
        print("  labrun :", by_labrun(model, data, "rate^3"), flush=True)
        print("  pysindy:", by_pysindy(data, INERTIA), flush=True)
    if given.silverbox is not None:
        question = ask(given.silverbox, None)
        print("silverbox; published: a cubic spring; labrun's own effect has -7.235e5 q^3")
        print("  labrun :", by_labrun(question.model, question.dataset, "q^3"), flush=True)
        print("  pysindy:", by_pysindy(question.dataset, 1.0), flush=True)


if __name__ == "__main__":
    main()
