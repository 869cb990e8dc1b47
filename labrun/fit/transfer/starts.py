"""Where the search for a transfer function starts, and the best minimum that its starts lead to."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError
from labrun.fit.transfer.estimation import Point, bounds, descend, evaluate
from labrun.fit.transfer.response import powers
from labrun.fit.transfer.shape import Shape
from labrun.fit.transfer.trials import ResponseTrial, total_s

FloatArray = NDArray[np.float64]
STARTS = 3
_SPEEDS = 6
_REFINED = 6
_DEADS = (0.0, 0.5, 1.0, 3.0, 10.0)
"""Dead times to start from, in units of the time constant a start has."""


def best_fit(
    shape: Shape, trials: Sequence[ResponseTrial], *, starts: int = STARTS, near: Sequence[FloatArray] = ()
) -> Point:
    """Return the best of the minima that the most promising starts lead to.

    Starts come from linear least squares on input and output filtered alike, at several speeds of the filter, which is
    then replaced by the denominator found (the refined method of Young and Jakeman 1980, without its noise model).

    `near` are starts that are followed besides.

    Raises
    ------
    FitError
        An input or output that does not move, or fewer samples than numbers to be found.
    """
    _require(shape, trials)
    low, high = bounds(shape, trials)
    rated: list[tuple[float, int, FloatArray]] = []
    for moved in _candidates(shape, trials):
        inside = np.clip(moved, low, high)
        squares = evaluate(shape, trials, inside).squares
        if np.isfinite(squares):
            rated.append((squares, len(rated), inside))
    rated.sort(key=lambda one: one[:2])
    ends = [descend(shape, trials, moved) for _, _, moved in rated[: max(starts, 1)]]
    ends += [descend(shape, trials, start) for start in near]
    return min(ends, key=lambda end: end.squares)


def _require(shape: Shape, trials: Sequence[ResponseTrial]) -> None:
    if all(np.ptp(trial.given) == 0.0 for trial in trials):
        raise FitError(
            "the input does not change in any trial: nothing tells what the output answers to",
            hint="fit trials in which it moves; [fit.settings.responses.NAME] where = ... chooses them",
        )
    if all(np.ptp(trial.measured[trial.used]) == 0.0 for trial in trials if np.any(trial.used)):
        raise FitError("the output does not change in any trial", hint="is it the right channel?")
    count = sum(int(np.count_nonzero(trial.used)) for trial in trials)
    if count < 3 * (shape.size + len(trials)):
        raise FitError(f"{count} samples are too few for {shape.size} numbers", hint="fit fewer poles")


def _candidates(shape: Shape, trials: Sequence[ResponseTrial]) -> list[FloatArray]:
    step_s = min(trial.step_s for trial in trials)
    slowest = total_s(trials) / 3.0
    found = []
    for lag_s in np.geomspace(min(2.0 * step_s, slowest), slowest, _SPEEDS):
        for dead_s in (share * lag_s for share in (_DEADS if shape.dead_time else (0.0,))):
            poles = np.full(shape.poles, -1.0 / lag_s, dtype=complex)
            found.append(shape.at(poles, dead_s))
            for _ in range(_REFINED if shape.poles > 1 else 0):
                refined = _filtered_least_squares(shape, trials, poles, dead_s)
                if refined is None:
                    break
                poles = refined
                found.append(shape.at(poles, dead_s))
    return found


def _filtered_least_squares(
    shape: Shape, trials: Sequence[ResponseTrial], poles: NDArray[np.complex128], dead_s: float
) -> NDArray[np.complex128] | None:
    """Return the poles that least squares finds on signals filtered by 1/denominator."""
    denominator = tuple(np.real(np.poly(poles)).tolist())
    rows, aims = [], []
    for trial in trials[:8]:
        ins = powers(denominator, dead_s, trial.step_s, trial.given, trial.hold, float(trial.given[0]))
        outs = powers(denominator, 0.0, trial.step_s, trial.measured, "linear", float(trial.measured[0]))
        constant = np.ones((len(ins), 1))
        columns = np.column_stack([-outs[:, : shape.poles], ins[:, : shape.zeros + 1], constant])
        rows.append(columns[trial.used])
        aims.append(outs[trial.used, shape.poles])
    table, aim = np.concatenate(rows), np.concatenate(aims)
    sizes = np.linalg.norm(table, axis=0)
    if not np.all(np.isfinite(sizes)) or np.any(sizes[: shape.poles] == 0.0):
        return None
    sizes[sizes == 0.0] = 1.0
    solved = np.linalg.lstsq(table / sizes, aim, rcond=1e-12)[0] / sizes
    roots = np.roots([1.0, *solved[: shape.poles][::-1]])
    if not np.all(np.isfinite(roots)) or np.any(np.abs(roots) == 0.0):
        return None
    return np.asarray(-np.abs(roots.real) + 1j * roots.imag)
