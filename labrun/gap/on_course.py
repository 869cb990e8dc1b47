"""Plants that leave any simulation: kept on course by what was measured of them.

A balanced pole, a magnet that holds a ball, a helicopter: driven by what its controller put out, the simulation leaves
the measured motion e times further every moment, whatever the model. An observer holds it there (the predictor of
prediction-error methods: Ljung, System Identification (1999), chapter 7), and what the model lacks shows in what it is
held against.
"""

from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.estimate import significant
from labrun.fit import Dataset, FitTrial
from labrun.gap import numerics
from labrun.gap.motion import smoothed
from labrun.models import Model, measured_name, observed, simulate
from labrun.store import SignalInfo

_HELD_IN_WELLS = 0.25
"""Part of the squares of a missing force in one line from which it holds the motion in wells, if it passes so many."""
_RUNS_AWAY = 9.0
"""Logarithm of the growth over a trial from which its end says nothing of its beginning."""
_HELD_ON_COURSE = 0.1
"""... by an observer in which what differs falls at least at this part of the rate that it grew at."""
_PLACES_ALONG = 12
_STATE_STEPS = 3
"""Places of a trial where a model is linearised, and steps to the states that show what was measured there."""


def kept_on_course(dataset: Dataset, model: Model) -> tuple[Dataset, Model, str]:
    """Return trials, and a model that they hold on course where it needs that, with a sentence; else as given.

    A model needs it if, linearised along the measured motion, it is so unstable that a trial's end depends on its
    beginning by many orders of magnitude, and if it does leave the motion.
    """
    if not model.states or any(output.followed for output in model.outputs):
        return dataset, model, ""
    trials = [trial for trial in dataset.trials if len(trial.time_s) >= numerics.FEWEST_STEPS]
    if not trials:
        return dataset, model, ""
    seen = [_linearised(model, trial) for trial in trials]
    slope, shown = (np.mean(np.concatenate(parts), axis=0) for parts in zip(*seen, strict=True))
    if not np.isfinite(slope).all():
        return dataset, model, ""
    growth = float(np.max(np.linalg.eigvals(slope).real))
    duration_s = float(np.median([trial.time_s[-1] - trial.time_s[0] for trial in trials]))
    if growth * duration_s < _RUNS_AWAY or not _leaves(model, dataset, trials):
        return dataset, model, ""
    held = _held(dataset, model, trials, slope, shown, _HELD_ON_COURSE * growth)
    if held is None:
        return dataset, model, ""
    return *held, (
        f"The model is unstable in open loop: what differs grows e-fold in {significant(1.0 / growth, 2)} s, and no "
        f"simulation follows what was measured for long. {_SAID}"
    )


def kept_in_wells(dataset: Dataset, model: Model, growth: float) -> tuple[Dataset, Model, str] | None:
    """Return trials, and a model that they hold in the wells of a force that it lacks, with a sentence.

    Parameters
    ----------
    growth
        How fast what differs grows between the wells, 1/s.

    Returns
    -------
    tuple or None
        None where outputs do not show what there is to hold.
    """
    trials = [trial for trial in dataset.trials if len(trial.time_s) >= numerics.FEWEST_STEPS]
    if not trials or not model.states or any(output.followed for output in model.outputs):
        return None
    seen = [_linearised(model, trial) for trial in trials]
    slope, shown = (np.mean(np.concatenate(parts), axis=0) for parts in zip(*seen, strict=True))
    if not np.isfinite(slope).all():
        return None
    held = _held(dataset, model, trials, slope, shown, _HELD_IN_WELLS * growth)
    if held is None:
        return None
    return *held, (
        f"A force that comes back along the coordinate holds the motion in wells, between which what differs grows "
        f"e-fold in {significant(1.0 / growth, 2)} s: a simulation that falls into the wrong one stays there. {_SAID}"
    )


_SAID = (
    "So it was kept on course by an observer: the gap is that of its prediction, and what sensors do (delays, zeros, "
    "gains of outputs) was not looked for."
)


def _held(
    dataset: Dataset, model: Model, trials: list[FitTrial], slope: FloatArray, shown: FloatArray, fall: float
) -> tuple[Dataset, Model] | None:
    """Return trials that tell a model what was measured, and the model that follows it as fast as `fall`, 1/s."""
    gain = _gain(slope, shown, fall, np.std(np.concatenate([trial.outputs for trial in trials]), axis=0))
    if gain is None:
        return None
    infos = [SignalInfo(measured_name(output.name), output.unit) for output in dataset.outputs]
    followed = replace(
        dataset,
        inputs=(*dataset.inputs, *infos),
        trials=tuple(
            replace(trial, inputs=np.column_stack([trial.inputs, trial.outputs])) for trial in dataset.trials
        ),
    )
    return followed, observed(model, gain, trials[0].condition)


@np.errstate(all="ignore")
def _linearised(model: Model, trial: FitTrial) -> tuple[FloatArray, FloatArray]:
    """Return derivatives of slopes (k, n, n) and outputs (k, m, n) by the states, along a measured motion."""
    p, force = model.vector(None, trial.condition), np.zeros(max(len(model.sites), 1))
    values, rates, _ = smoothed(trial.time_s, trial.outputs)
    derivative, output = model.derivative.python, model.output.python
    count, outputs = len(model.states), len(model.outputs)
    size = np.maximum(np.ptp(values, axis=0), 1e-12)
    speed = np.maximum(np.sqrt(np.mean(np.square(rates), axis=0)), 1e-12)
    nudge = 1e-6 * float(np.max(size))

    def at(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        dx, y = np.zeros(count), np.zeros(outputs)
        try:
            derivative(0.0, np.ascontiguousarray(x), u, p, force, dx)
            output(0.0, np.ascontiguousarray(x), u, p, force, y)
        except (
            ArithmeticError,
            ValueError,
        ):  # equations that do not hold there: machine code gives no number
            dx[:], y[:] = np.nan, np.nan
        return dx, y

    def slopes(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        a, c = np.empty((count, count)), np.empty((outputs, count))
        for state in range(count):
            step = np.zeros(count)
            step[state] = nudge
            (up, shown_up), (down, shown_down) = at(x + step, u), at(x - step, u)
            a[:, state], c[:, state] = (up - down) / (2 * nudge), (shown_up - shown_down) / (2 * nudge)
        return a, c

    vs = {output.name: float(v) for output, v in zip(model.outputs, values[0], strict=True)}
    x = model.initial_state(trial.condition, first={**vs, **model.told_first(trial.inputs[0])}, free=vs)
    samples = np.linspace(0, len(trial.time_s) - 1, _PLACES_ALONG).astype(int)
    drifts, readouts = [], []
    for sample in samples:
        u = np.ascontiguousarray(trial.inputs[sample])
        for _ in range(_STATE_STEPS):  # states that show what was measured, and its rate
            dx, y = at(x, u)
            a, c = slopes(x, u)
            short = np.concatenate([(values[sample] - y) / size, (rates[sample] - c @ dx) / speed])
            rows = np.concatenate([c / size[:, None], (c @ a) / speed[:, None]])
            if not (np.isfinite(rows).all() and np.isfinite(short).all()):
                return np.full((1, count, count), np.nan), np.full((1, outputs, count), np.nan)
            x = x + np.linalg.lstsq(rows, short, rcond=1e-9)[0]
        a, c = slopes(x, u)
        drifts.append(a)
        readouts.append(c)
    return np.array(drifts), np.array(readouts)


def _leaves(model: Model, dataset: Dataset, trials: list[FitTrial]) -> bool:
    """Tell whether the simulation leaves the measured motion in most trials."""
    between = {signal.name: signal.between for signal in dataset.inputs}
    driven, far = model.with_between(between), 0
    for trial in trials:
        values = {
            output.name: float(value) for output, value in zip(model.outputs, trial.outputs[0], strict=True)
        }
        begin = model.initial_state(
            trial.condition, first={**values, **model.told_first(trial.inputs[0])}, free=values
        )
        outputs = simulate(
            driven, trial.time_s, trial.inputs, condition=trial.condition, initial_state=begin, substeps=4
        ).outputs
        away = np.sqrt(np.mean(np.square(outputs - trial.outputs), axis=0))
        far += not bool(np.all(away < np.maximum(np.std(trial.outputs, axis=0), 1e-12)))
    return 2 * far > len(trials)


def _gain(slope: FloatArray, shown: FloatArray, fall: float, size: FloatArray) -> FloatArray | None:
    """Return the least gain (in the outputs' sizes) that makes what differs fall; None where outputs do not show it.

    Every mode that falls more slowly than `fall` (1/s) is mirrored about that: the Riccati equation of a Kalman filter
    without process noise (Anderson and Moore, Optimal Control (1990), section 3.5).
    """
    from scipy.linalg import LinAlgError, solve_continuous_are

    seen = shown / np.maximum(size, 1e-12)[:, None]
    moved = slope + fall * np.eye(len(slope))
    try:
        covariance = solve_continuous_are(
            moved.T, seen.T, 1e-9 * fall * np.diag(1.0 / np.maximum(np.sum(seen**2, axis=0), 1e-12)),
            np.eye(len(seen)),
        )  # fmt: skip
    except (LinAlgError, ValueError, ArithmeticError):
        return None
    gain = covariance @ seen.T / np.maximum(size, 1e-12)
    held = np.linalg.eigvals(slope - gain @ shown)
    return gain if np.isfinite(gain).all() and float(np.max(held.real)) < -0.5 * fall else None
