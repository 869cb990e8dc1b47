"""The force that, applied at a site over time, would close the gap."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.gap.diagnosis import MissingForce
from labrun.gap.where.absorbed import Absorbed
from labrun.gap.where.cycle import find_cycle
from labrun.gap.where.difference import Difference
from labrun.gap.where.profile import profile
from labrun.gap.where.site_units import coordinate_unit, force_unit, load_unit
from labrun.gap.where.smoothing import smooth
from labrun.models import Simulation, Site, simulate

_KNOTS_PER_CYCLE = 12
"""Straight pieces follow the third harmonic, which a cubic or a sign has, to a few percent then."""
_MOST_KNOTS, _FEWEST_KNOTS = 96, 8
_MOST_COEFFICIENTS = 640
_FEWEST_SAMPLES = 16
_MOST_UNITS = 80
_VISIBLE = (0.03, 3.0)
"""Change of the outputs that a probing force should make, in units of the noise: seen well, and still small."""
_PROBES = 40
_ROUNDS = 3
_AS_GOOD = 0.02
"""Part of the excess by which a simulation may miss what its linearisation promised."""


@dataclass(frozen=True)
class _Course:
    """Forces at the knots of every unit, the simulations with them, and the squares they leave (white, projected)."""

    forces: list[FloatArray]
    simulations: list[Simulation]
    left: float


def missing_forces(difference: Difference) -> tuple[MissingForce, ...]:
    """Return, for every joint and body site, the force over time that would close the gap.

    It is straight between knots, about twelve per cycle and at most 96 in a unit of data; its roughness is penalised,
    with a weight that generalised cross-validation chooses; what recalibration can do is left to it. Coordinate, rate
    and load are those of the simulation with this force, which is closer to what was measured than that without.

    `share` is told on the data the force was fitted to, less what it takes out of the noise: so free a force also
    imitates what is no force at all, an error of an output for one. A site that no output sees is left out; so are
    units of fewer than 16 samples. Beyond 80 units, some of every condition stand for all.
    """
    some = _subset(difference)
    if some is None or not some.model.sites:
        return ()
    found = [_at(some, site, place) for place, site in enumerate(some.model.sites)]
    return tuple(sorted((one for one in found if one is not None), key=lambda one: -one.share))


def _subset(difference: Difference) -> Difference | None:
    units = difference.units.trials
    long = [index for index, unit in enumerate(units) if len(unit.time_s) >= _FEWEST_SAMPLES]
    seen: dict[int, int] = {}
    rank = {}
    for index in long:
        rank[index] = seen.setdefault(units[index].group, 0)
        seen[units[index].group] += 1
    chosen = sorted(sorted(long, key=lambda index: rank[index])[:_MOST_UNITS])
    if not chosen:
        return None
    if len(chosen) == len(units):
        return difference
    kept = tuple(units[index] for index in chosen)
    ends = np.cumsum([one.size for one in difference.residual])[:-1]
    rows = None if difference.jacobian is None else np.split(difference.jacobian, ends)
    return replace(
        difference,
        units=replace(difference.units, trials=kept),
        initial=tuple(difference.initial[index] for index in chosen),
        drives=tuple(difference.drives[index] for index in chosen),
        simulated=tuple(difference.simulated[index] for index in chosen),
        residual=tuple(difference.residual[index] for index in chosen),
        jacobian=None if rows is None else np.concatenate([rows[index] for index in chosen]),
    )


def _at(difference: Difference, site: Site, place: int) -> MissingForce | None:
    if difference.noise.basis == "residual":
        # the colour of a residual is that of the gap: whitening by it would hide what is looked for
        difference = replace(difference, noise=difference.noise.plain())
    search = _Search(difference, site)
    course = search.course()
    if course is None:
        return None
    from labrun.models import site_course

    trials = difference.units.trials
    motion = [
        site_course(
            difference.model,
            trial.time_s,
            simulation.states,
            trial.inputs,
            parameters=difference.parameters,
            condition=trial.condition,
        )[:, place]
        for trial, simulation in zip(trials, course.simulations, strict=True)
    ]
    return MissingForce(
        site=site.name,
        unit=force_unit(difference.model, site, difference.output_units),
        share=search.share(course),
        labels=tuple(trial.label for trial in trials),
        time_s=tuple(trial.time_s for trial in trials),
        force=tuple(
            np.interp(trial.time_s, knots, forces)
            for trial, knots, forces in zip(trials, search.knots, course.forces, strict=True)
        ),
        coordinate=tuple(one[:, 0] for one in motion),
        rate=tuple(one[:, 1] for one in motion),
        load=tuple(one[:, 2] for one in motion) if site.load else (),
        coordinate_unit=coordinate_unit(difference.model, site, difference.output_units),
        load_unit=load_unit(difference.model, site, difference.output_units),
    )


class _Search:
    def __init__(self, difference: Difference, site: Site) -> None:
        self._difference = difference
        self._site = site
        self._absorbed = Absorbed(difference)
        self.knots = _knots(difference)
        self._expected = 0.0
        self._before = self._left(list(difference.residual))

    def course(self) -> _Course | None:
        """Fit the force, relinearising about it until a simulation keeps what the last linearisation promised."""
        size = self._size()
        if size is None:
            return None
        course = self._simulated([np.zeros(len(one)) for one in self.knots])
        best: _Course | None = None
        for _ in range(_ROUNDS):
            if course is None:
                break
            promised, forces = self._step(course, size)
            course = self._simulated(forces)
            if course is None or (best is not None and course.left >= best.left):
                break
            best = course
            if course.left - promised <= _AS_GOOD * self._before:
                break
        return best

    def share(self, course: _Course) -> float:
        """Return the part of the excess that a course explains, less what it takes out of the noise."""
        told = self._difference.noise.basis == "repeats"
        count = sum(one.size for one in self._difference.residual) - self._absorbed.rank
        excess = self._before - (count if told else 0.0)
        if excess <= 0:
            return 0.0
        left = course.left - (self._expected if told else 0.0)
        return float(np.clip(1.0 - left / excess, 0.0, 1.0))

    def _left(self, residual: Sequence[FloatArray]) -> float:
        white = self._absorbed.white([one / self._difference.noise_sd for one in residual])
        along = self._absorbed.span.T @ white
        return float(white @ white - along @ along)

    def _step(self, course: _Course, size: float) -> tuple[float, list[FloatArray]]:
        """Return the squares a linear fit about a course promises to leave, and its forces."""
        blocks, changes = [], []
        for index, (knots, forces) in enumerate(zip(self.knots, course.forces, strict=True)):
            base = course.simulations[index].outputs
            columns = []
            for knot in range(len(knots)):
                pushed = forces.copy()
                pushed[knot] += size
                simulation = self._simulate(index, pushed)
                change = (simulation.outputs - base) / size if simulation.finite else np.zeros_like(base)
                columns.append(self._white(change, index))
            block = np.stack(columns, axis=1)
            blocks.append(block)
            residual = self._difference.residual[index] + self._difference.simulated[index] - base
            changes.append(self._white(residual, index) + block @ forces)
        values, span = np.concatenate(changes), self._absorbed.span
        result = smooth(blocks, values, span)
        self._expected = result.expected
        rest = values - np.concatenate([b @ c for b, c in zip(blocks, result.coefficients, strict=True)])
        along = span.T @ rest
        return float(rest @ rest - along @ along), result.coefficients

    def _white(self, values: FloatArray, index: int) -> FloatArray:
        noise, root = self._difference.noise, np.sqrt(self._difference.units.trials[index].count)
        return np.asarray(
            noise.whitener.white(values / self._difference.noise_sd).ravel() * root, dtype=float
        )

    def _simulated(self, forces: list[FloatArray]) -> _Course | None:
        simulations = [self._simulate(index, one) for index, one in enumerate(forces)]
        if not all(one.finite for one in simulations):
            return None
        residual = [
            left + before - one.outputs
            for left, before, one in zip(
                self._difference.residual, self._difference.simulated, simulations, strict=True
            )
        ]
        return _Course(forces, simulations, self._left(residual))

    def _simulate(self, index: int, forces: FloatArray) -> Simulation:
        difference, knots = self._difference, self.knots[index]
        trial = difference.units.trials[index]
        pushed = profile(self._site, float(knots[0]), float(knots[1] - knots[0]), forces.tolist())
        return simulate(
            difference.model,
            trial.time_s,
            difference.drives[index],
            parameters=difference.parameters,
            condition=trial.condition,
            initial_state=difference.initial[index],
            effects=(*difference.effects, pushed),
        )

    def _size(self) -> float | None:
        """Return a force that changes the outputs by about the noise, if any does."""
        flat = self._simulate(0, np.zeros(len(self.knots[0])))
        force = 1.0
        for _ in range(_PROBES):
            pushed = self._simulate(0, np.full(len(self.knots[0]), force))
            if not pushed.finite:
                force *= 1e-2
                continue
            moved = float(np.max(np.abs(pushed.outputs - flat.outputs) / self._difference.noise_sd))
            if _VISIBLE[0] <= moved <= _VISIBLE[1]:
                return force
            force *= 1e4 if moved == 0.0 else np.clip(0.3 / moved, 1e-4, 1e4)
            if not 1e-15 < force < 1e15:
                return None
        return None


def _knots(difference: Difference) -> list[FloatArray]:
    most = max(_FEWEST_KNOTS, min(_MOST_KNOTS, _MOST_COEFFICIENTS // len(difference.units.trials)))
    found = []
    for unit, simulated in zip(difference.units.trials, difference.simulated, strict=True):
        trial = unit
        signals = [*trial.inputs.T, *simulated.T]
        cycle = find_cycle(trial.time_s, signals, trial.condition)
        duration = float(trial.time_s[-1] - trial.time_s[0])
        wanted = most if cycle is None else int(np.ceil(_KNOTS_PER_CYCLE * duration / cycle.period_s)) + 1
        count = min(most, max(_FEWEST_KNOTS, wanted), len(trial.time_s))
        found.append(np.linspace(trial.time_s[0], trial.time_s[-1], count))
    return found
