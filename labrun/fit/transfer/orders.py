"""Whether a pole or a zero more or less would be worth it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from labrun.fit.correlation import correlation_length
from labrun.fit.summary import TextTable
from labrun.fit.transfer.estimation import shortest_s
from labrun.fit.transfer.fitting import TransferFit
from labrun.fit.transfer.shape import Shape
from labrun.fit.transfer.starts import best_fit

FloatArray = NDArray[np.float64]
_WORTH = 0.05
"""A fall of the error by less is not worth another number."""
_ROUNDING = 5e-4
"""An order may leave so much more than a smaller one, relatively, before its search counts as ended too early."""


def compare_orders(fit: TransferFit, name: str) -> tuple[TextTable, list[str]]:
    """Return the neighbouring orders with error and Akaike's criterion, and a sentence on each that is larger.

    The criterion counts independent samples: those there are over the residual's correlation length. An order can leave
    no more than a smaller one, which it contains; where its fit does, the search has not converged: it is marked so,
    without a criterion.
    """
    shape = fit.shape
    shapes = [shape]
    for poles, zeros in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        p, z = shape.poles + poles, shape.zeros + zeros
        if p >= 1 and 0 <= z <= p:
            shapes.append(Shape(p, z, shape.dead_time, initial=shape.initial))
    residuals = fit.residuals()
    count = sum(len(part) for part in residuals)
    effective = count / max(correlation_length(residuals), 1.0)
    squares = {
        other: fit.point.squares
        if other is shape
        else best_fit(other, fit.trials, starts=2, near=_near(fit, other)).squares
        for other in sorted(shapes, key=lambda one: (one.poles, one.zeros))
    }
    missed = unconverged(squares)
    rows, said = [], []
    for other, left in squares.items():
        rms = float(np.sqrt(left / count))
        aic = effective * float(np.log(max(left, 1e-300) / count)) + 2.0 * other.size
        mark = " (this one)" if other is shape else ""
        last = "did not converge" if other in missed else f"{aic:.1f}"
        rows.append((f"{other.poles}{mark}", str(other.zeros), f"{rms:.4g}", last))
        if other is shape and other in missed:
            said.append(
                f"{name}: this order left more than a smaller one, which it contains: its fit did not converge; "
                "take the smaller one (poles, zeros)"
            )
        if other.poles + other.zeros > shape.poles + shape.zeros and other not in missed:
            fall = 1.0 - np.sqrt(left / max(fit.point.squares, 1e-300))
            what = "a pole more" if other.poles > shape.poles else "a zero more"
            verdict = "not worth it" if fall < _WORTH else "worth a try"
            said.append(f"{name}: {what} would lower the error by {100 * max(fall, 0.0):.2g} %: {verdict}")
    header = ("poles", "zeros", f"RMS, {fit.transfer.output_unit}", "AIC")
    return TextTable(f"{name}: other orders", header, tuple(rows)), said


def unconverged(squares: Mapping[Shape, float]) -> set[Shape]:
    """Return the orders that left more, as a sum of squares, than a smaller one that they contain."""
    return {
        one
        for one, left in squares.items()
        for other, less in squares.items()
        if (other.poles, other.zeros) != (one.poles, one.zeros)
        and other.poles <= one.poles
        and other.zeros <= one.zeros
        and left > less * (1.0 + _ROUNDING) ** 2
    }


def _near(fit: TransferFit, other: Shape) -> list[FloatArray]:
    """Return this fit as a point of another order: a pole more is the fastest there is, which changes least."""
    poles = fit.transfer.poles
    if other.poles > fit.shape.poles:
        poles = np.append(poles, -1.0 / shortest_s(fit.trials))
    elif other.poles < fit.shape.poles:
        return []
    return [other.at(poles, fit.transfer.dead_s)]
