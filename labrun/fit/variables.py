"""The variables of a fit and what is believed of them: shared parameters, and what each trial has of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.fit.dataset import FitTrial
from labrun.models import Drive, Model, Parameter

_UNBELIEVED = 1e4
"""Standard deviation of a free variable for the search, in units of its scale."""


@dataclass(frozen=True, eq=False)
class Priors:
    """Parameters of a model and of effects in it; which of them are fitted, in which scale, and held by what.

    Attributes
    ----------
    values : (k,)
        All of them, SI: the model's parameters in its order, then those of each effect.
    free : (p,), integers
        Places of the fitted ones among them: the variables. All arrays below are theirs.
    scale : (p,)
        What a scaled variable is a multiple of.
    sigma : (p,)
        Standard deviation of the stated value; inf where nothing was stated.
    pull : (p,)
        The same for the search, finite: where the data say nothing, it must not wander off.
    lower, upper : (p,)
        Bounds of the scaled variables.
    weight
        Factor on the prior's residuals.
    """

    values: FloatArray
    free: NDArray[np.intp]
    names: tuple[str, ...]
    scale: FloatArray
    sigma: FloatArray
    pull: FloatArray
    lower: FloatArray
    upper: FloatArray
    weight: float = 1.0

    @classmethod
    def of(cls, model: Model, *, weight: float = 1.0) -> Self:
        """Take a model's parameters as stated; those of tolerance 0 are no variables."""
        free = [index for index, parameter in enumerate(model.parameters) if parameter.tolerance != 0]
        parameters = [model.parameters[index] for index in free]
        scale = np.array(
            [abs(parameter.value) if parameter.value != 0 else 1.0 for parameter in parameters], dtype=float
        )
        # a tolerance is relative; to one for a parameter of value zero
        relative = [
            np.inf if isinstance(parameter.tolerance, str) else parameter.tolerance
            for parameter in parameters
        ]
        sigma = np.array(relative, dtype=float) * scale
        return cls(
            model.values,
            np.array(free, dtype=np.intp),
            tuple(parameter.name for parameter in parameters),
            scale,
            sigma,
            np.where(np.isfinite(sigma), sigma, _UNBELIEVED * scale),
            np.array([parameter.lower for parameter in parameters], dtype=float) / scale,
            np.array([parameter.upper for parameter in parameters], dtype=float) / scale,
            weight,
        )

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(self.free)

    @property
    def stated(self) -> FloatArray:
        """The scaled variables as stated, (p,)."""
        return np.asarray(self.values[self.free] / self.scale)

    @property
    def slope(self) -> FloatArray:
        """Derivative of each variable's prior residual by the variable, (p,)."""
        return np.asarray(-self.weight * self.scale / self.pull)

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return all values, those of the variables taken from the front of `z`."""
        values = self.values.copy()
        values[self.free] = z[: self.size] * self.scale
        return values

    def residual(self, z: FloatArray) -> FloatArray:
        """Return (stated value - value) / sigma of the variables; next to nothing where none was stated."""
        away = (self.values[self.free] - z[: self.size] * self.scale) / self.pull
        return np.asarray(self.weight * away)

    def with_effects(self, effects: Sequence[AttachedEffect], scales: Sequence[Scale], first: int) -> Self:
        """Return priors with the parameters of further effects, of which all that are not held are variables.

        `scales`: what is typical at the site of each. `first`: number of the first of them among all effects, which
        names their variables: "0.torque".
        """
        added = [
            (parameter, value, number, typical.of(parameter.quantity))
            for number, (attached, typical) in enumerate(zip(effects, scales, strict=True), start=first)
            for parameter, value in zip(attached.effect.parameters, attached.values, strict=True)
        ]
        free = [
            index for index, (parameter, *_) in enumerate(added, start=len(self.values)) if not parameter.held
        ]
        fitted = [pair for pair in added if not pair[0].held]
        scale = np.array([size for *_, size in fitted])
        behind = {
            "values": [value for _, value, _, _ in added],
            "free": np.array(free, dtype=np.intp),
            "scale": scale,
            "sigma": np.full(len(fitted), np.inf),
            "pull": _UNBELIEVED * scale,
            "lower": [variable.lower for variable, *_ in fitted],
            "upper": [variable.upper for variable, *_ in fitted],
        }
        arrays: dict[str, Any] = {
            key: np.concatenate([getattr(self, key), new]) for key, new in behind.items()
        }
        names = (*self.names, *(f"{number}.{variable.name}" for variable, _, number, _ in fitted))
        return replace(self, names=names, **arrays)

    def within(self, tolerances: float) -> Self:
        """Return priors that let a variable move by at most so many of its stated standard deviations."""
        room = tolerances * (self.sigma / self.scale)
        believed = np.isfinite(room)
        return replace(
            self,
            lower=np.where(believed, np.maximum(self.lower, self.stated - room), self.lower),
            upper=np.where(believed, np.minimum(self.upper, self.stated + room), self.upper),
        )

    def releasing(self, parameter: Parameter, factor: float) -> Self:
        """Return priors that believe a parameter's statement only to a factor, of either sign."""
        variable = self.names.index(parameter.name)
        scale = self.scale[variable]
        stated = parameter.value / scale
        low, high = sorted((-stated * factor, stated * factor)) if stated else (-np.inf, np.inf)
        put = {
            "sigma": np.inf,
            "pull": _UNBELIEVED * scale,
            "lower": max(parameter.lower / scale, low),
            "upper": min(parameter.upper / scale, high),
        }
        arrays: dict[str, Any] = {
            key: changed(getattr(self, key), variable, value) for key, value in put.items()
        }
        return replace(self, **arrays)


def changed(values: FloatArray, index: int | list[int], value: float | FloatArray) -> FloatArray:
    """Return values with others at one place, or at some."""
    values = values.copy()
    values[index] = value
    return values


FIRST_SAMPLES = 3
"""How many samples "first" averages: few, because the output may already move."""


@dataclass(frozen=True, eq=False)
class InitialStates:
    """The initial states of a model in each of its trials.

    Attributes
    ----------
    spread : (m,)
        Size of each output.
    sd : (m,)
        Standard deviation of a single trial's samples.
    read_free
        Whether a state that begins at the "first" samples is free too, held by what noise they have.
    short
        Whether the trials are beginnings only: what is read from the first samples is taken from them then.
    """

    model: Model
    trials: tuple[FitTrial, ...]
    spread: FloatArray
    sd: FloatArray
    read_free: bool
    short: bool

    @cached_property
    def read(self) -> tuple[int, ...]:
        """Places of the states that begin at the first samples and are free."""
        if not self.read_free:
            return ()
        rules = [self.model.initial.get(name) for name in self.model.states]
        return tuple(state for state, rule in enumerate(rules) if rule == "first")

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Places of the states whose beginning is fitted."""
        rules = [self.model.initial.get(name, "free") for name in self.model.states]
        return tuple(sorted({*self.read, *(state for state, rule in enumerate(rules) if rule == "free")}))

    @cached_property
    def scale(self) -> FloatArray:
        """Typical size of each free state: that of the output it is, or of the largest one."""
        shown = [self.output_of(state) for state in self.free]
        return np.array(
            [float(np.max(self.spread) if output is None else self.spread[output]) for output in shown]
        )

    def state(self, trial: int, own: FloatArray) -> FloatArray:
        """Return the initial state of one trial, shape (k,), with its free ones, scaled, as in `own` (q,)."""
        names = [self.model.states[state] for state in self.free]
        free = dict(zip(names, own * self.scale, strict=True))
        first = self._first[trial] if self.short else {**self._first[trial], **free}
        return self.model.initial_state(self.trials[trial].condition, first=first, free=free)

    def read_residual(self, trial: int, own: FloatArray) -> FloatArray:
        """Return (first samples - free state) / sigma of the states that begin there; empty where none is free."""
        if self.short or not self.read:
            return np.empty(0)
        places = [self.free.index(state) for state in self.read]
        means = np.array([self._first[trial][self.model.states[state]] for state in self.read])
        return np.asarray((means - own[places] * self.scale[places]) / self._sigma[trial])

    def output_of(self, state: int) -> int | None:
        """Return the column of the output of a state's name, which is how a model shows it."""
        name = self.model.states[state]
        return self._shown.index(name) if name in self._shown else None

    @cached_property
    def _first(self) -> list[Mapping[str, float]]:
        """Mean of the first samples of every output, and the first sample of every input, trial by trial."""
        means = [np.mean(trial.outputs[:FIRST_SAMPLES], axis=0).tolist() for trial in self.trials]
        return [
            {**self.model.told_first(trial.inputs[0]), **dict(zip(self._shown, mean, strict=True))}
            for trial, mean in zip(self.trials, means, strict=True)
        ]

    @cached_property
    def _sigma(self) -> list[FloatArray]:
        """How well the first samples tell the states that begin there: their noise, and how far they moved."""
        columns = [self._shown.index(self.model.states[state]) for state in self.read]
        moved = [np.ptp(trial.outputs[:FIRST_SAMPLES, columns], axis=0) for trial in self.trials]
        return [
            np.hypot(self.sd[columns] / np.sqrt(trial.count), state) + 1e-9 * self.spread[columns]
            for trial, state in zip(self.trials, moved, strict=True)
        ]

    @cached_property
    def _shown(self) -> list[str]:
        return [output.name for output in self.model.outputs]


DeviationKind = Literal["bias", "gain", "start time", "initial state", "input bias", "input gain"]
SIMULATED: tuple[DeviationKind, ...] = ("initial state", "input bias", "input gain")
"""What a simulation begins with, or is driven by; the others change its outputs."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """A deviation that every trial has of its own, normally distributed about zero.

    Attributes
    ----------
    output
        Column of the output that it shows in; None for all, which a start time shifts together. Of an initial state,
        the place of the state; of an input's bias or gain, the column of the input.
    sd
        Standard deviation over trials: in the output's, state's or input's unit, of a factor, or in s.
    """

    kind: DeviationKind
    output: int | None
    sd: float


def driven(drive: Drive, deviations: Sequence[Deviation], own: FloatArray, count: int) -> Drive:
    """Return the inputs of the mean of `count` trials with the deviations that are theirs, as `deviated` outputs."""
    for deviation, size in zip(deviations, own, strict=True):
        if deviation.kind not in ("input bias", "input gain") or deviation.output is None:
            continue
        away, u, last = size * deviation.sd / np.sqrt(count), drive.u.copy(), drive.u_last.copy()
        for values in (u, last):
            values[..., deviation.output] += away * (
                values[..., deviation.output] if deviation.kind == "input gain" else 1.0
            )
        drive = replace(drive, u=u, u_last=last)
    return drive


def deviated(
    outputs: FloatArray, time_s: FloatArray, deviations: Sequence[Deviation], own: FloatArray, count: int
) -> FloatArray:
    """Return outputs (n, m) of the mean of `count` trials with their deviations, `own` in standard deviations.

    Initial states and inputs are left out: the simulation has them already.
    """
    shifted = outputs.copy()
    for deviation, size in zip(
        deviations, own * [each.sd / np.sqrt(count) for each in deviations], strict=True
    ):
        columns = slice(None) if deviation.output is None else slice(deviation.output, deviation.output + 1)
        if deviation.kind == "bias":
            shifted[:, columns] += size
        elif deviation.kind == "gain":
            shifted[:, columns] *= 1.0 + size
        elif deviation.kind == "start time":
            late = time_s - size
            shifted[:, columns] = np.column_stack(
                [np.interp(late, time_s, each) for each in shifted[:, columns].T]
            )
    return shifted
