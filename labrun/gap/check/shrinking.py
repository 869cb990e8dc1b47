"""How much of the gap the causes really remove: on fresh trials, in conditions that no fit has seen."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.errors import FitError
from labrun.gap.excess import Excess, excess, mean_residuals
from labrun.gap.noise import Noise, from_repeats
from labrun.gap.problem import GapProblem
from labrun.gap.recalibration import member_residuals, stated
from labrun.gap.units import Units, gather

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from labrun.models import Model

_COUNTED = 2.0
"""A fresh gap below so many times what noise alone shows is too small for a share of its square to mean anything."""


def shown(folder: Path, said: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Simulate the recalibrated and the corrected model on fresh trials; return the share of the excess removed.

    Parameters are what the diagnosis found; only initial states are fitted, where the model leaves them free or
    lets them begin at the first samples.

    Parameters
    ----------
    folder
        A recording with repeats, with the case's ``model.toml`` beside it.
    said
        The diagnosis.
    seed
        Of the noise that the smallest gap worth counting is told from.

    Returns
    -------
    dict
        ``share`` removed; ``counted``, whether the fresh gap stands far enough above the noise; ``recalibrated`` and
        ``after``, the gaps in units of one trial's noise; ``floor``, what noise alone shows in 95 of 100.

    Raises
    ------
    FitError
        No repeats, or no excess at all.
    LabrunError
        A corrected model that does not hold, or leaves the finite numbers.
    """
    from labrun.fit.dataset import load_dataset
    from labrun.gap.estimates import floor_of
    from labrun.models import load_model

    model = load_model(folder / "model.toml")
    units = gather(load_dataset(folder, model), model)
    recalibrated = model.with_values(
        {name: one["recalibrated"] for name, one in said["recalibration"].items()}
    )
    problem = GapProblem(recalibrated, units)
    noise = from_repeats(units, member_residuals(problem, stated(problem, _begin(problem))))
    if noise is None:
        raise FitError("fresh trials without repeats cannot tell gap from noise")
    before = _excess(recalibrated, units, noise)
    after = _excess(corrected(model, said), units, noise)
    floor = floor_of(units, noise, np.random.default_rng(seed))
    if before.total <= 0:
        return {"share": 0.0, "counted": False, "recalibrated": 0.0, "after": after.gap, "floor": floor}
    return {
        "share": 1.0 - after.total / before.total,
        "counted": bool(before.gap > _COUNTED * floor),
        "recalibrated": before.gap,
        "after": after.gap,
        "floor": floor,
    }


def corrected(model: "Model", said: Mapping[str, Any]) -> "Model":
    """Return the model with the parameters and the effects that a diagnosis gives it."""
    from labrun.effects import AttachedEffect, load_effect

    effects = [
        AttachedEffect(load_effect(one["effect"], one["kind"]), one["site"], tuple(one["values"]))
        for one in said["effects"]
    ]
    return model.with_values(said["corrected"]).with_effects(effects)


def _excess(model: "Model", units: Units, noise: Noise) -> Excess:
    problem = GapProblem(model, units).with_noise(noise)
    return excess(units, noise, mean_residuals(problem, stated(problem, _begin(problem))))


def _begin(problem: GapProblem) -> "NDArray[np.float64]":
    return np.concatenate([problem.values[problem.free] / problem.scale, problem.guess(problem.values)])
