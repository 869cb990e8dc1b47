"""What is compared: a recalibrated model beside the mean of every unit of data, its conditions, and what moves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, unit_of
from labrun.fit import Dataset, FitTrial
from labrun.gap import criteria
from labrun.gap.noise import Noise
from labrun.models import Drive, Model, Site, simulate, site_course

_LEAST_SIGNAL = 1e-3
"""Of a signal that hardly varies."""
_STANDS_STILL = 0.02
"""Part of its peak rate below which something stands still, and does not reverse."""


@dataclass(frozen=True)
class Difference:
    """A model, and what the measurement says otherwise.

    Attributes
    ----------
    model
        With the way its inputs run between samples set as the recording says.
    units, noise
        The data, and how much of a single trial is noise.
    parameters : (parameters,)
        Recalibrated.
    effects
        Physics that is part of the model compared already; mostly none.
    initial : per unit (k,)
        State each unit begins in.
    drives : per unit
        Its inputs, as `labrun.models.prepare` lays them out.
    simulated : per unit (n, m)
    residual : per unit (n, m)
        Mean of the measured trials minus simulated, in the units of the outputs.
    jacobian : (sum of n*m, p)
        Derivative of the simulated outputs by what recalibration may change (free parameters and initial states),
        unit after unit, each (n, m) row by row. None where nothing was recalibrated.
    """

    model: Model
    units: Dataset
    noise: Noise
    parameters: FloatArray
    effects: tuple[AttachedEffect, ...]
    initial: tuple[FloatArray, ...]
    drives: tuple[Drive, ...]
    simulated: tuple[FloatArray, ...]
    residual: tuple[FloatArray, ...]
    jacobian: FloatArray | None = None

    @cached_property
    def noise_sd(self) -> FloatArray:
        """Standard deviation of one trial's noise, shape (m,), with what no model is believed to.

        Where nothing was repeated, noise is what the model leaves; channels of the same unit are then taken to have
        the same, or none could hold more of the gap than another.
        """
        sd = np.hypot(self.noise.sd, criteria.MODEL_ROUNDING * self.spread)
        return sd if self.noise.known else self._over_units(sd)

    @cached_property
    def scale(self) -> FloatArray:
        """What residuals are measured in, shape (m,): the noise, where repeats tell it, else how much signals vary."""
        if self.noise.known:
            return self.noise_sd
        return np.maximum(self._over_units(self.spread), self.noise_sd * _LEAST_SIGNAL)

    @property
    def output_units(self) -> list[str]:
        """Units of the outputs, as recorded."""
        return [output.unit for output in self.units.outputs]

    def _over_units(self, values: FloatArray) -> FloatArray:
        """Return the root mean square over all channels of the same unit."""
        units = self.output_units
        return np.array(
            [
                np.sqrt(np.mean([values[other] ** 2 for other, unit in enumerate(units) if unit == own]))
                for own in units
            ]
        )

    @cached_property
    def spread(self) -> FloatArray:
        """Standard deviation of each measured channel over all data, shape (m,)."""
        outputs = np.concatenate([unit.outputs for unit in self.units.trials])
        return np.asarray(np.std(outputs, axis=0), dtype=float)

    @cached_property
    def scaled(self) -> list[FloatArray]:
        """Residuals of every unit in units of `scale`."""
        return [residual / self.scale for residual in self.residual]


@dataclass(frozen=True)
class ConditionData:
    """All data of one condition, on the time base of its first unit.

    Attributes
    ----------
    group
        Number of the condition.
    members
        Dataset that are averaged in it.
    shares
        Their weights, by the number of trials behind each; they add up to 1.
    trial
        The first of them.
    length
        Samples that all of them have.
    """

    group: int
    members: tuple[int, ...]
    shares: FloatArray
    trial: FitTrial
    length: int

    @property
    def time_s(self) -> FloatArray:
        """Time base, shape (length,)."""
        return self.trial.time_s[: self.length]

    def of(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the weighted mean of arrays (n, ...) of every unit, over this piece's units."""
        if len(self.members) == 1:
            return values[self.members[0]][: self.length]
        stacked = np.stack([values[index][: self.length] for index in self.members])
        mean: FloatArray = np.tensordot(self.shares, stacked, axes=1)
        return mean

    def first(self, values: Sequence[FloatArray]) -> FloatArray:
        """Return the array of its first unit, cut to this piece's length."""
        return values[self.members[0]][: self.length]


def pieces(units: Dataset) -> tuple[ConditionData, ...]:
    """Return one piece per condition; units of a condition with another time step stay apart."""
    datas: list[ConditionData] = []
    for group in range(len(units.conditions)):
        alike: dict[float, list[int]] = {}
        for index in units.of_group(group):
            time_s = units.trials[index].time_s
            step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
            near = next((known for known in alike if abs(known - step) <= 0.01 * known), step)
            alike.setdefault(near, []).append(index)
        for members in alike.values():
            counts = np.array([units.trials[index].count for index in members], dtype=float)
            length = min(len(units.trials[index].time_s) for index in members)
            trial = units.trials[members[0]]
            datas.append(ConditionData(group, tuple(members), counts / counts.sum(), trial, length))
    return tuple(datas)


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
        """Tell whether it moves at all."""
        return any(np.ptp(coordinates) > 0 for coordinates in self.coordinate if len(coordinates) > 1)

    def peak_rate(self) -> float:
        """Return the peak of its speed, without the fastest few samples."""
        return float(np.percentile(np.abs(np.concatenate(self.rate)), _PEAK))

    def reversals(self, piece: int, time_s: FloatArray) -> FloatArray:
        """Return the times at which it turns: where its rate changes sign, between two times of really moving."""
        rate = self.rate[piece]
        threshold = _STANDS_STILL * float(np.max(np.abs(rate), initial=0.0))
        moving = np.flatnonzero(np.abs(rate) > threshold) if threshold > 0 else np.empty(0, dtype=int)
        turns = np.flatnonzero(np.diff(np.sign(rate[moving])) != 0)
        before, after = moving[turns], moving[turns + 1]
        return np.asarray(0.5 * (time_s[before] + time_s[after]), dtype=float)


def site_movers(difference: Difference, pieces: Sequence[ConditionData]) -> tuple[Mover, ...]:
    """Return every joint and body site that moves, along the simulated trajectories."""
    model = difference.model
    courses = unit_courses(difference)
    if not model.sites or courses is None:
        return ()
    rows = []
    for index, site in enumerate(model.sites):
        columns = [[piece.first(courses)[:, index, quantity] for piece in pieces] for quantity in range(3)]
        rows.append(
            Mover(
                site.name,
                site.kind,
                tuple(columns[0]),
                tuple(columns[1]),
                tuple(columns[2]) if site.load else (),
            )
        )
    return tuple(row for row in rows if row.moves)


def unit_courses(difference: Difference) -> list[FloatArray] | None:
    """Return coordinate, rate, load and stiffness at every site, (n, sites, 4) per unit; None if not finite."""
    courses = []
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
        courses.append(
            site_course(
                difference.model,
                unit.time_s,
                simulation.states,
                unit.inputs,
                parameters=difference.parameters,
                condition=unit.condition,
            )
        )
    return courses


def input_movers(difference: Difference, pieces: Sequence[ConditionData]) -> tuple[Mover, ...]:
    """Return every input that changes within trials, or between them where a trial is one sample."""
    rows = []
    for column, signal in enumerate(difference.model.inputs):
        values = tuple(piece.trial.inputs[: piece.length, column] for piece in pieces)
        rates = tuple(
            np.gradient(value, piece.time_s) if len(value) > 1 else np.zeros(1)
            for value, piece in zip(values, pieces, strict=True)
        )
        mover = Mover(signal.name, "input", values, rates)
        if mover.moves or np.ptp(np.concatenate(values)) > 0:
            rows.append(mover)
    return tuple(rows)


def force_unit(model: Model, site: Site, measured: Mapping[str, str]) -> str:
    """Return the unit of a force (or torque) at a joint or body site."""
    return unit_of("force", model.coordinate_unit(site, measured))


def load_unit(model: Model, site: Site, measured: Mapping[str, str]) -> str:
    """Return the unit of the load of a site: of the output it is, else that of the force; "" where there is no load.

    The library's load-dependent friction is a pure number times the load, which therefore is a force of its kind.
    """
    if not site.load:
        return ""
    unit = measured.get(site.load, "1")
    return force_unit(model, site, measured) if unit == "1" else unit
