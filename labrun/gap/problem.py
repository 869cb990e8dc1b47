"""Residuals of a model with candidate effects, whitened by the noise, as functions of parameters and effect sizes."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from labrun.errors import FitError
from labrun.fit.pieces import FIRST_SAMPLES, prior_sigma
from labrun.fit.problem import Problem
from labrun.gap import criteria
from labrun.gap.noise import Noise
from labrun.gap.recent import Recent
from labrun.gap.tally import Tally
from labrun.gap.units import Units
from labrun.gap.workers import stop_if_told

if TYPE_CHECKING:
    from labrun.effects import AttachedEffect, Scale
    from labrun.models import Drive, Model

FloatArray = NDArray[np.float64]

_LOOSE = 1e4
_HUGE = 1e3


class GapProblem(Problem):
    """A model with effects, beside the mean of every unit of data.

    The scaled variables are the free parameters, the sizes of the effects, and for every unit its free initial
    states; a state that begins at the "first" samples is free too, held by what noise they have.

    Parameters
    ----------
    units
        The data.
    released
        Names of parameters whose stated value and tolerance are not believed.
    tally
        Counts simulations without effects; shared by all problems that are made from this one.
    """

    def __init__(self, model: "Model", units: Units) -> None:
        self.units = units
        self.noise: Noise | None = None
        self.released: frozenset[str] = frozenset()
        self.scales: tuple[Scale, ...] = ()
        self._prior_of_first: list[FloatArray] = []
        self._firsts: list[int] = []
        self._model_size = len(model.parameters)
        self._recent = Recent()
        self.tally = Tally()
        super().__init__(model, units.dataset)
        self._firsts = [
            state for state, name in enumerate(model.states) if model.initial.get(name) == "first"
        ]
        self._bound_within_tolerance()
        if self._firsts:
            self.free_states = sorted({*self.free_states, *self._firsts})
            self.state_scale = self._state_scale()
            self._set_first_priors()

    def with_noise(self, noise: Noise) -> Self:
        """Return the same problem, measured in units of this noise."""
        other = copy(self)
        other.noise = noise
        sd = np.sqrt(noise.sd**2 + (criteria.MODEL_ROUNDING * self.spread) ** 2)
        other.weights = 1.0 / sd
        other._set_first_priors()
        return other

    def with_effects(self, effects: "Sequence[AttachedEffect]", scales: "Sequence[Scale]") -> Self:
        """Return the problem with further effects whose parameters are variables too."""
        other = copy(self)
        other.effects = (*self.effects, *effects)
        other.scales = (*self.scales, *scales)
        values, free, names = list(self.values), list(self.free), list(self.names)
        scale, lower, upper = list(self.scale), list(self.lower), list(self.upper)
        prior, pull = list(self.prior_sigma), list(self.pull_sigma)
        for number, (attached, typical) in enumerate(
            zip(effects, scales, strict=True), start=len(self.effects)
        ):
            for parameter, value in zip(attached.effect.parameters, attached.values, strict=True):
                if not parameter.held:
                    size = typical.of(parameter.quantity)
                    free.append(len(values))
                    names.append(f"{number}.{parameter.name}")
                    scale.append(size)
                    lower.append(parameter.lower)
                    upper.append(parameter.upper)
                    prior.append(np.inf)
                    pull.append(_LOOSE * size)
                values.append(value)
        other.values, other.free, other.names = np.array(values), free, names
        other.scale, other.lower, other.upper = np.array(scale), np.array(lower), np.array(upper)
        other.prior_sigma, other.pull_sigma = np.array(prior), np.array(pull)
        return other

    def releasing(self, name: str) -> Self:
        """Return the problem with one parameter free of what was stated about it."""
        other = copy(self)
        other.released = self.released | {name}
        variable = self.names.index(name)
        parameter = next(one for one in self.model.parameters if one.name == name)
        stated = parameter.value / self.scale[variable]
        ends = sorted((stated / criteria.FAR_OFF, stated * criteria.FAR_OFF)) if stated else (-np.inf, np.inf)
        for attribute, value in (
            ("prior_sigma", np.inf),
            ("pull_sigma", _LOOSE * self.scale[variable]),
            ("lower", max(parameter.lower / self.scale[variable], ends[0])),
            ("upper", min(parameter.upper / self.scale[variable], ends[1])),
        ):
            changed = getattr(self, attribute).copy()
            changed[variable] = value
            setattr(other, attribute, changed)
        return other

    def finer(self, times: int) -> Self:
        """Return the problem with so many times as many of the integrator's steps."""
        other = copy(self)
        other.substeps = times * self.substeps
        other._drives = other._prepared()
        return other

    def of_units(self, chosen: Sequence[int]) -> Self:
        """Return the problem of some of the units."""
        other = copy(self)
        units = tuple(self.units.units[index] for index in chosen)
        trials = tuple(unit.trial for unit in units)
        other.dataset = replace(self.dataset, trials=trials)
        other.units = replace(self.units, units=units, dataset=other.dataset)
        other._drives = [self._drives[index] for index in chosen]
        other._first = [self._first[index] for index in chosen]
        if self._prior_of_first:
            other._prior_of_first = [self._prior_of_first[index] for index in chosen]
        return other

    def with_measured(self, outputs: Sequence[FloatArray]) -> Self:
        """Return the problem with other measured means: the same experiment, had it come out differently."""
        other = copy(self)
        units = tuple(
            replace(unit, trial=replace(unit.trial, outputs=one))
            for unit, one in zip(self.units.units, outputs, strict=True)
        )
        other.dataset = replace(self.dataset, trials=tuple(unit.trial for unit in units))
        other.units = replace(self.units, units=units, dataset=other.dataset)
        other._first = [other._first_values(trial) for trial in other.dataset.trials]
        return other

    def at(self, units: Units) -> Self:
        """Return the problem of other trials, held against the same prior and in the same units of noise."""
        other = copy(self)
        other.units, other.dataset = units, units.dataset
        other._drives = other._prepared()
        other._first = [other._first_values(trial) for trial in units.dataset.trials]
        other._set_first_priors()
        return other

    def attached(self, parameters: FloatArray) -> "tuple[AttachedEffect, ...]":
        """Return the effects with their sizes, from the vector that `parameters` gives."""
        found, at = [], self._model_size
        for one in self.effects:
            found.append(one.with_values(parameters[at : at + len(one.values)].tolist()))
            at += len(one.values)
        return tuple(found)

    def model_parameters(self, z: FloatArray) -> FloatArray:
        """Return the parameters of the model alone."""
        return self.parameters(z)[: self._model_size]

    def initial_state(self, trial: int, own: FloatArray) -> FloatArray:
        """Return the initial state of one unit, shape (k,)."""
        names = [self.model.states[state] for state in self.free_states]
        free = dict(zip(names, own * self.state_scale, strict=True))
        first = {**self._first[trial], **free}
        return self.model.initial_state(self.dataset.trials[trial].condition, first=first, free=free)

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one unit; None where they are not finite."""
        from labrun.models import simulate

        stop_if_told()
        data, effects = self.dataset.trials[trial], self.attached(parameters)
        start = self.initial_state(trial, own)
        if any(one.effect.kind == "output" for one in effects):
            return self._shown(parameters[: self._model_size], trial, start, effects)
        simulation = simulate(
            self.model,
            data.time_s,
            self._drives[trial],
            parameters=parameters[: self._model_size],
            condition=data.condition,
            initial_state=start,
            effects=effects,
        )
        if not effects:
            self.tally.count(finite=simulation.finite)
        return simulation.outputs if simulation.finite else None

    def _shown(
        self, parameters: FloatArray, trial: int, start: FloatArray, effects: "tuple[AttachedEffect, ...]"
    ) -> FloatArray | None:
        """Return the outputs of one unit behind effects at outputs, which share what is before them."""
        from labrun.models import filtered, simulate_unfiltered

        drive = self._drives[trial]
        inside = tuple(one for one in effects if one.effect.kind != "output")
        same = tuple((id(one.effect), one.site, one.values) for one in inside)
        before = self._recent.get(
            (id(drive), parameters.tobytes(), start.tobytes(), same),
            lambda: simulate_unfiltered(
                self.model,
                drive,
                parameters=parameters,
                condition=self.dataset.trials[trial].condition,
                initial_state=start,
                effects=inside,
            ),
        )
        found = filtered(self.model, before, effects)
        return found.outputs if found.finite else None

    def simulated(self, z: FloatArray) -> list[FloatArray]:
        """Return the outputs of every unit.

        Raises
        ------
        FitError
            The model leaves the finite numbers.
        """
        parameters = self.parameters(z)
        found = []
        for index, trial in enumerate(self.dataset.trials):
            outputs = self.simulate(parameters, index, self.own(z, index))
            if outputs is None:
                raise FitError(
                    f"model {self.model.name} leaves the finite numbers in {trial.label}",
                    hint="check the units of its parameters and inputs, the sign of forces that should resist motion, "
                    "and how its states begin",
                )
            found.append(outputs)
        return found

    def trial_residual(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return measured minus simulated of one unit in units of its noise, white, flat; None where not finite.

        Behind it stand the first samples' residuals, where a state begins there.
        """
        outputs = self.simulate(parameters, trial, own)
        if outputs is None:
            return None
        residual = (self.dataset.trials[trial].outputs - outputs) * self.weights
        limit = _HUGE * float(np.max(self.weights * self.spread))
        return np.concatenate(
            [self.white(np.clip(residual, -limit, limit), trial).ravel(), self._begin(trial, own)]
        )

    def white(self, weighted: FloatArray, trial: int) -> FloatArray:
        """Return weighted values (n, m) of a unit as multiples of the noise of its mean, white."""
        if self.noise is None:
            return weighted
        return self.noise.whitener.white(weighted) / self.noise.mean_sd(self.units.units[trial].count)

    def finite_residuals(self, z: FloatArray) -> list[FloatArray] | None:
        """Return the whitened residual of every unit; None where a simulation is not finite."""
        parameters, found = self.parameters(z), []
        for index in range(len(self.dataset.trials)):
            residual = self.trial_residual(parameters, index, self.own(z, index))
            if residual is None:
                return None
            found.append(residual)
        return found

    def residuals(self, z: FloatArray) -> list[FloatArray]:
        """Return the whitened residual of every unit, huge where the simulation is not finite."""
        parameters = self.parameters(z)
        huge = _HUGE * float(np.max(self.weights * self.spread))
        found = []
        for index, trial in enumerate(self.dataset.trials):
            own = self.own(z, index)
            residual = self.trial_residual(parameters, index, own)
            found.append(
                np.concatenate([np.full(trial.outputs.size, huge), self._begin(index, own)])
                if residual is None
                else residual
            )
        return found

    def shorten_steps(self, z: FloatArray) -> bool:
        """Halve the integrator's steps until that moves the outputs by a small part of the noise; tell whether it did.

        What integration alone differs by must not be taken for physics.
        """
        shortened = False
        before = self.simulated(z)
        while self.substeps < criteria.MOST_SUBSTEPS:
            self.substeps *= 2
            self._drives = self._prepared()
            after = self.simulated(z)
            moved = max(
                float(np.max(np.sqrt(np.mean(np.square((one - two) * self.weights), axis=0))))
                for one, two in zip(before, after, strict=True)
            )
            if moved <= criteria.INTEGRATION_ERROR:
                self.substeps //= 2
                self._drives = self._prepared()
                return shortened
            shortened, before = True, after
        return shortened

    def sensitivities(self, z: FloatArray) -> FloatArray:
        """Return the derivative of the simulated outputs by all variables but effect sizes, (sum of n*m, variables).

        Unit after unit, each (n, m) row by row, in the units of the outputs.
        """
        plain = copy(self)
        plain.noise = None
        blocks = plain.blocks(z)
        rows = []
        for index, (shared, own) in enumerate(zip(blocks.shared, blocks.own, strict=True)):
            trial = self.dataset.trials[index]
            wide = np.zeros((trial.outputs.size, self.size + self.own_size * len(self.dataset.trials)))
            wide[:, : self.size] = shared[: trial.outputs.size]
            begin = self.size + index * self.own_size
            wide[:, begin : begin + self.own_size] = own[: trial.outputs.size]
            rows.append(-wide / np.tile(self.weights, len(trial.time_s))[:, None])
        return np.concatenate(rows)

    def residual_rows(self) -> list[range]:
        """Return the rows of every unit's residual."""
        firsts = len(self._firsts) if self._prior_of_first else 0
        return [range(trial.outputs.size + firsts) for trial in self.dataset.trials]

    def squares(self, z: FloatArray) -> float:
        """Return the sum of squared residuals, prior included."""
        prior = self.prior_residual(z)
        return float(prior @ prior) + sum(float(part @ part) for part in self.residuals(z))

    def drive(self, trial: int) -> "Drive":
        """Return the inputs of a unit as prepared for simulation."""
        return self._drives[trial]

    def _begin(self, trial: int, own: FloatArray) -> FloatArray:
        if not self._prior_of_first:
            return np.empty(0)
        away = []
        for place, state in enumerate(self.free_states):
            if state in self._firsts:
                name = self.model.states[state]
                sigma = self._prior_of_first[trial][self._firsts.index(state)]
                away.append((self._first[trial][name] - own[place] * self.state_scale[place]) / sigma)
        return np.array(away)

    def _set_first_priors(self) -> None:
        """Hold a state that begins at the first samples by their noise, and by how far they moved."""
        self._prior_of_first = []
        if not self._firsts:
            return
        names = [output.name for output in self.model.outputs]
        for unit in self.units.units:
            sigmas = []
            for state in self._firsts:
                column = names.index(self.model.states[state])
                sd = self.spread[column] * 0.01 if self.noise is None else 1.0 / self.weights[column]
                moved = float(np.ptp(unit.trial.outputs[:FIRST_SAMPLES, column]))
                sigmas.append(np.hypot(sd / np.sqrt(unit.count), moved) + 1e-9 * self.spread[column])
            self._prior_of_first.append(np.array(sigmas))

    def _bound_within_tolerance(self) -> None:
        for variable, index in enumerate(self.free):
            parameter = self.model.parameters[index]
            sigma = prior_sigma(parameter.tolerance, self.values[index]) / self.scale[variable]
            if np.isfinite(sigma):
                stated = self.values[index] / self.scale[variable]
                self.lower[variable] = max(self.lower[variable], stated - criteria.WITHIN_TOLERANCES * sigma)
                self.upper[variable] = min(self.upper[variable], stated + criteria.WITHIN_TOLERANCES * sigma)


def own_states(problem: GapProblem, z: FloatArray) -> FloatArray:
    """Return the part of `z` that belongs to the units."""
    return z[problem.size :]


def named(problem: GapProblem, z: FloatArray) -> Mapping[str, float]:
    """Return the model's parameters by name."""
    values = problem.model_parameters(z)
    return {one.name: float(value) for one, value in zip(problem.model.parameters, values, strict=True)}
