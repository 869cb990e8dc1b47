"""The force that, applied at a site over time, would close the gap."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Effect, EffectParameter, force_law
from labrun.gap.diagnosis import MissingForce
from labrun.gap.learnable import predictable_share
from labrun.gap.where.difference import Difference, force_unit, load_unit
from labrun.gap.where.periods import find_cycle
from labrun.gap.where.significance import NuisanceSubspace
from labrun.models import Pointer, Simulation, Site, SiteKind, simulate, site_course

_KNOTS_PER_CYCLE = 12
"""Knots of the missing force per cycle."""
_FEWEST_KNOTS = 8
"""Fewest knots in a unit of data."""
_MOST_KNOTS = 96
"""Most knots in a unit of data."""
_MOST_COEFFICIENTS = 640
"""Most knots over all units."""
_FEWEST_FORCE_SAMPLES = 16
"""Samples of a unit below which it has no missing force."""
_MOST_FORCE_UNITS = 80
"""Units of data beyond which none is looked for."""
_FORCE_AS_GOOD = 0.02
"""Part of the excess by which a simulation may miss what its linearisation promised."""

_RIDGE = 1e-6
"""Beside the roughness: keeps a constant nobody sees from growing without bound."""
_PENALTIES = 50
"""Weights of the roughness that are compared."""


@dataclass(frozen=True)
class Smooth:
    """Coefficients of every block, and what they leave.

    Attributes
    ----------
    coefficients : per block (k,)
    expected
        Sum of squares that white noise of variance 1 would leave of itself.
    """

    coefficients: list[FloatArray]
    expected: float


def smooth(blocks: Sequence[FloatArray], values: FloatArray, span: FloatArray) -> Smooth:
    """Fit every block's rows by its own columns, with smooth coefficients, beside a span that is free.

    Minimises ``|v - H c|^2 + penalty |second differences of c|^2`` after projecting `span` out of both sides
    (B-splines with a difference penalty: Eilers and Marx 1996), the penalty, one for all, by generalised
    cross-validation (Craven and Wahba 1979).

    Parameters
    ----------
    blocks : per unit (rows, k)
    values : (all rows,)
    span : (all rows, p)
        Orthonormal columns.
    """
    from scipy.linalg import block_diag, eigh

    ends = np.cumsum([len(block) for block in blocks])[:-1]
    remainder = values - span @ (span.T @ values)
    spanned = np.concatenate(
        [part.T @ block for part, block in zip(np.split(span, ends), blocks, strict=True)], axis=1
    )
    gram = block_diag(*[block.T @ block for block in blocks]) - spanned.T @ spanned
    right = np.concatenate(
        [block.T @ part for block, part in zip(blocks, np.split(remainder, ends), strict=True)]
    )
    rough = block_diag(*[_roughness(block.shape[1]) for block in blocks])
    size, vectors = eigh(gram, rough)
    size = np.maximum(size, 0.0)
    seen = vectors.T @ right
    free = len(values) - span.shape[1]
    whole = float(remainder @ remainder)
    best, chosen = np.inf, float(size.max()) + 1e-300
    for penalty in float(size.max()) * np.geomspace(1e-12, 10.0, _PENALTIES) + 1e-300:
        shrunk = 1.0 / (size + penalty)
        rest = whole - float(np.sum(seen**2 * (2.0 * shrunk - size * shrunk**2)))
        used = float(np.sum(size * shrunk))
        score = rest / max(free - used, 1.0) ** 2
        if score < best:
            best, chosen = score, float(penalty)
    kept = size / (size + chosen)
    expected = free - float(np.sum(2.0 * kept - kept**2))
    coefficients = vectors @ (seen / (size + chosen))
    return Smooth(np.split(coefficients, np.cumsum([block.shape[1] for block in blocks])[:-1]), expected)


def _roughness(count: int) -> FloatArray:
    differences = np.diff(np.eye(count), n=2, axis=0)
    return np.asarray(differences.T @ differences + _RIDGE * np.eye(count), dtype=float)


# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses


def _profile_law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return the force at time `t`: `values` holds the first knot's time, the knots' distance, their number, forces."""
    last = int(values[2]) - 1
    position = (t - values[0]) / values[1]
    if position <= 0.0:
        return values[3]
    if position >= last:
        return values[3 + last]
    knot = int(position)
    part = position - knot
    return (1.0 - part) * values[3 + knot] + part * values[4 + knot]


def profile(site: Site, begin_s: float, step_s: float, forces: Sequence[float]) -> AttachedEffect:
    """Return the effect of forces at evenly spaced knots (linear B-splines), held beyond both ends."""
    return AttachedEffect(
        _profile_effect(site.kind, len(forces)),
        site.name,
        (begin_s, step_s, float(len(forces)), *map(float, forces)),
    )


@functools.cache
def _profile_effect(kind: SiteKind, count: int) -> Effect:
    names = ["begin", "step", "count", *(f"force_{knot}" for knot in range(count))]
    return Effect(
        "force-profile",
        kind,
        tuple(EffectParameter(name, "force", None, float("-inf"), float("inf"), (0.0,)) for name in names),
        force_law(_profile_law),
        "F = F(t)",
        "of the diagnosis itself",
    )


_LAWFUL = 0.5
"""Share of a missing force's square that motion and load have to predict where it was withheld."""
_VISIBLE = (0.03, 3.0)
"""Change of the outputs that a probing force should make, in units of the noise: seen well, and still small."""
_PROBES = 40
"""Sizes of a probing force that are tried, at most."""
_ROUNDS = 3
"""Linearisations of one force, at most."""


@dataclass(frozen=True)
class _Course:
    """Forces at the knots of every unit, the simulations with them, and the squares they leave (white, projected)."""

    forces: list[FloatArray]
    simulations: list[Simulation]
    squares: float


def missing_forces(difference: Difference) -> tuple[MissingForce, ...]:
    """Return, for every joint and body site, the force over time that would close the gap.

    It is straight between knots, about twelve per cycle and at most 96 in a unit of data; its roughness is penalised,
    with a weight that generalised cross-validation chooses; what recalibration can do is left to it. Coordinate, rate
    and load are those of the simulation with this force, which is closer to what was measured than that without.

    `share` is measured on the data the force was fitted to, less what it takes out of the noise: so free a force also
    imitates what is no force at all, an error of an output for one. A force that motion and load do not predict in
    withheld pieces of time is left out; so is a site that no output sees, and units of fewer than 16 samples. Beyond 80
    units, some of every condition stand for all.
    """
    some = _subset(difference)
    if some is None or not some.model.sites:
        return ()
    forces = [_at(some, site, index) for index, site in enumerate(some.model.sites)]
    lawful = [force for force in forces if force is not None and _is_a_law(force)]
    return tuple(sorted(lawful, key=lambda force: -force.share))


def _is_a_law(missing: MissingForce) -> bool:
    """Tell whether motion and load predict a missing force in pieces of time that were withheld.

    A force that differs from trial to trial at the same motion imitates something else.
    """
    columns = [missing.coordinate, missing.rate, *([missing.load] if missing.load else [])]
    features = [np.column_stack(parts) for parts in zip(*columns, strict=True)]
    return predictable_share(features, missing.force) >= _LAWFUL


def _subset(difference: Difference) -> Difference | None:
    units = difference.units.trials
    long = [index for index, unit in enumerate(units) if len(unit.time_s) >= _FEWEST_FORCE_SAMPLES]
    seen: dict[int, int] = {}
    rank = {}
    for index in long:
        rank[index] = seen.setdefault(units[index].group, 0)
        seen[units[index].group] += 1
    chosen = sorted(sorted(long, key=lambda index: rank[index])[:_MOST_FORCE_UNITS])
    if not chosen:
        return None
    if len(chosen) == len(units):
        return difference
    kept = tuple(units[index] for index in chosen)
    ends = np.cumsum([residual.size for residual in difference.residual])[:-1]
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


def _at(difference: Difference, site: Site, site_index: int) -> MissingForce | None:
    if not difference.noise.known:
        # the colour of a residual is that of the gap: whitening by it would hide what is looked for
        difference = replace(difference, noise=difference.noise.plain())
    search = _Search(difference, site)
    course = search.course()
    if course is None:
        return None

    trials = difference.units.trials
    motion = [
        site_course(
            difference.model,
            trial.time_s,
            simulation.states,
            trial.inputs,
            parameters=difference.parameters,
            condition=trial.condition,
        )[:, site_index]
        for trial, simulation in zip(trials, course.simulations, strict=True)
    ]
    return MissingForce(
        site=site.name,
        unit=force_unit(difference.model, site, difference.units.signal_units),
        share=search.share(course),
        labels=tuple(trial.label for trial in trials),
        time_s=tuple(trial.time_s for trial in trials),
        force=tuple(
            np.interp(trial.time_s, knots, forces)
            for trial, knots, forces in zip(trials, search.knots, course.forces, strict=True)
        ),
        coordinate=tuple(course[:, 0] for course in motion),
        rate=tuple(course[:, 1] for course in motion),
        load=tuple(course[:, 2] for course in motion) if site.load else (),
        coordinate_unit=difference.model.coordinate_unit(site, difference.units.signal_units),
        load_unit=load_unit(difference.model, site, difference.units.signal_units),
    )


class _Search:
    def __init__(self, difference: Difference, site: Site) -> None:
        self._difference = difference
        self._site = site
        self._nuisance = NuisanceSubspace(difference)
        self.knots = _knots(difference)
        self._expected = 0.0
        self._before = self._remaining(list(difference.residual))

    def course(self) -> _Course | None:
        """Fit the force, relinearising about it until a simulation keeps what the last linearisation promised."""
        size = self._size()
        if size is None:
            return None
        course = self._simulated([np.zeros(len(knot)) for knot in self.knots])
        best: _Course | None = None
        for _ in range(_ROUNDS):
            if course is None:
                break
            promised, forces = self._step(course, size)
            course = self._simulated(forces)
            if course is None or (best is not None and course.squares >= best.squares):
                break
            best = course
            if course.squares - promised <= _FORCE_AS_GOOD * self._before:
                break
        return best

    def share(self, course: _Course) -> float:
        """Return the part of the excess that a course explains, less what it takes out of the noise."""
        known = self._difference.noise.known
        count = sum(residual.size for residual in self._difference.residual) - self._nuisance.rank
        excess = self._before - (count if known else 0.0)
        if excess <= 0:
            return 0.0
        rest = course.squares - (self._expected if known else 0.0)
        return float(np.clip(1.0 - rest / excess, 0.0, 1.0))

    def _remaining(self, residual: Sequence[FloatArray]) -> float:
        white = self._nuisance.white(
            [trial_residual / self._difference.noise_sd for trial_residual in residual]
        )
        along = self._nuisance.span.T @ white
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
        values, span = np.concatenate(changes), self._nuisance.span
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
        simulations = [self._simulate(index, force) for index, force in enumerate(forces)]
        if not all(simulation.finite for simulation in simulations):
            return None
        residual = [
            remainder + before - simulation.outputs
            for remainder, before, simulation in zip(
                self._difference.residual, self._difference.simulated, simulations, strict=True
            )
        ]
        return _Course(forces, simulations, self._remaining(residual))

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
    most = max(
        _FEWEST_KNOTS,
        min(_MOST_KNOTS, _MOST_COEFFICIENTS // len(difference.units.trials)),
    )
    knots = []
    for unit, simulated in zip(difference.units.trials, difference.simulated, strict=True):
        trial = unit
        signals = [*trial.inputs.T, *simulated.T]
        cycle = find_cycle(trial.time_s, signals, trial.condition)
        duration = float(trial.time_s[-1] - trial.time_s[0])
        wanted = most if cycle is None else int(np.ceil(_KNOTS_PER_CYCLE * duration / cycle.period_s)) + 1
        count = min(most, max(_FEWEST_KNOTS, wanted), len(trial.time_s))
        knots.append(np.linspace(trial.time_s[0], trial.time_s[-1], count))
    return knots
