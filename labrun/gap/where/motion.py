"""What moves in a trial, as the model has it: coordinates and rates of the sites, and the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.gap.where.difference import Difference
from labrun.gap.where.pooling import Piece

FloatArray = NDArray[np.float64]

_MOVING = 0.02
"""Part of the peak rate below which something stands still, and does not reverse."""
_PEAK = 99.5


@dataclass(frozen=True)
class Mover:
    """A coordinate with its rate, over every piece of data.

    Attributes
    ----------
    name, kind
        Of the site or of the input.
    coordinate, rate, load : per piece (n,)
        `load` is empty where there is none.
    """

    name: str
    kind: str
    coordinate: tuple[FloatArray, ...]
    rate: tuple[FloatArray, ...]
    load: tuple[FloatArray, ...] = ()

    @property
    def label(self) -> str:
        """Its name, for people."""
        return f"input {self.name}" if self.kind == "input" else self.name

    @property
    def moves(self) -> bool:
        """Whether it moves at all."""
        return any(np.ptp(one) > 0 for one in self.coordinate if len(one) > 1)

    def peak_rate(self) -> float:
        """Return the peak of its speed, without the fastest few samples."""
        return float(np.percentile(np.abs(np.concatenate(self.rate)), _PEAK))

    def reversals(self, piece: int, time_s: FloatArray) -> FloatArray:
        """Return the times at which it turns: where its rate changes sign, between two times of really moving."""
        rate = self.rate[piece]
        threshold = _MOVING * float(np.max(np.abs(rate), initial=0.0))
        moving = np.flatnonzero(np.abs(rate) > threshold) if threshold > 0 else np.empty(0, dtype=int)
        turns = np.flatnonzero(np.diff(np.sign(rate[moving])) != 0)
        before, after = moving[turns], moving[turns + 1]
        return np.asarray(0.5 * (time_s[before] + time_s[after]), dtype=float)


def site_movers(difference: Difference, pieces: Sequence[Piece]) -> tuple[Mover, ...]:
    """Return every joint and body site that moves, along the simulated trajectories."""
    model = difference.model
    courses = unit_courses(difference)
    if not model.sites or courses is None:
        return ()
    found = []
    for place, site in enumerate(model.sites):
        columns = [[piece.first(courses)[:, place, quantity] for piece in pieces] for quantity in range(3)]
        found.append(
            Mover(
                site.name,
                site.kind,
                tuple(columns[0]),
                tuple(columns[1]),
                tuple(columns[2]) if site.load else (),
            )
        )
    return tuple(one for one in found if one.moves)


def unit_courses(difference: Difference) -> list[FloatArray] | None:
    """Return coordinate, rate, load and stiffness at every site, (n, sites, 4) per unit; None if not finite."""
    from labrun.models import simulate, site_course

    found = []
    for index, unit in enumerate(difference.units.trials):
        simulation = simulate(
            difference.model,
            unit.time_s,
            difference.drives[index],
            parameters=difference.parameters,
            condition=unit.condition,
            initial_state=difference.initial[index],
            effects=difference.effects,
        )
        if not simulation.finite:
            return None
        found.append(
            site_course(
                difference.model,
                unit.time_s,
                simulation.states,
                unit.inputs,
                parameters=difference.parameters,
                condition=unit.condition,
            )
        )
    return found


def input_movers(difference: Difference, pieces: Sequence[Piece]) -> tuple[Mover, ...]:
    """Return every input that changes within trials, or between them where a trial is one sample."""
    found = []
    for column, one in enumerate(difference.model.inputs):
        values = tuple(piece.trial.inputs[: piece.length, column] for piece in pieces)
        rates = tuple(
            np.gradient(value, piece.time_s) if len(value) > 1 else np.zeros(1)
            for value, piece in zip(values, pieces, strict=True)
        )
        mover = Mover(one.name, "input", values, rates)
        if mover.moves or np.ptp(np.concatenate(values)) > 0:
            found.append(mover)
    return tuple(found)
