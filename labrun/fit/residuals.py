"""What a model with effects leaves of measured trials, in units of the noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.errors import FitError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.per_trial import Deviation, InitialStates, deviated, driven
from labrun.fit.priors import Priors
from labrun.fit.simulations import Simulations, stop_if_told
from labrun.models import Drive, Model, filtered, prepare, simulate, simulate_unfiltered, suggest_substeps

FEWEST_SAMPLES = 25
"""A beginning of a trial is at least this long, if the trial is."""
_HUGE = 1e3
"""Residual, in units of a channel's own spread, of a simulation that left the finite numbers."""
_MOST_SUBSTEPS = 64
_PROBED_TRIALS = 3
_READ = 0.01
"""Part of an output's spread that a state read from its first samples is taken to be uncertain by, noise unknown."""


@dataclass(frozen=True, eq=False)
class OutputNoise:
    """What residuals are measured in.

    Attributes
    ----------
    weights : (m,)
        One over the standard deviation of each output.
    whiten
        Makes the weighted residual (n, m) of a trial, the mean of so many, white; left as it is if None.
    """

    weights: FloatArray
    whiten: Callable[[FloatArray, int], FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class Residuals:
    """What a model with effects leaves of its trials, by scaled variables; nothing in it changes.

    The vector `z` holds the variables of the priors, then the free initial states of the first trial, of the second,
    and so on, each divided by its scale. A trial's initial states change that trial alone, so that their derivatives
    cost one pair of simulations of one trial each, whatever the number of trials.

    Attributes
    ----------
    spread : (m,)
        Size of each output.
    drives
        Inputs of every trial on the integrator's steps, laid out once for all simulations of it.
    read_free
        Whether a state that begins at the "first" samples is free too, held by what noise they have.
    short
        Whether the trials are beginnings only: what is read from the first samples is taken from them then.
    deviations
        What every trial has of its own beside its initial states, behind which it stands in `z`.
    seen : per trial (n,), or None for all
        1 for samples that count, 0 for those that are withheld.
    """

    data: Dataset
    model: Model
    effects: tuple[AttachedEffect, ...]
    priors: Priors
    noise: OutputNoise
    spread: FloatArray
    drives: tuple[Drive, ...]
    read_free: bool = False
    short: bool = False
    deviations: tuple[Deviation, ...] = ()
    seen: tuple[FloatArray, ...] | None = None
    simulations: Simulations = field(default_factory=Simulations)

    @cached_property
    def _huge(self) -> float:
        return _HUGE * float(np.max(self.noise.weights * self.spread))

    # --- variables ------------------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of variables that all trials share."""
        return self.priors.size

    @property
    def own_size(self) -> int:
        """Number of free initial states and deviations of one trial."""
        return len(self.states.free) + len(self.deviations)

    @property
    def behind(self) -> int:
        """Number of rows behind the samples of a trial's residual: what is read of initial states, and deviations."""
        return len(self.states.read) + len(self.deviations)

    @property
    def substeps(self) -> int:
        """Steps of the integrator per sample."""
        return self.drives[0].substeps

    @cached_property
    def states(self) -> InitialStates:
        """How the trials begin."""
        sd = self.spread * _READ if self.noise.whiten is None else 1.0 / self.noise.weights
        return InitialStates(self.model, self.data.trials, self.spread, sd, self.read_free, self.short)

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return all parameters of model and effects, in their order and units."""
        return self.priors.parameters(z)

    def model_parameters(self, z: FloatArray) -> FloatArray:
        """Return the parameters of the model alone."""
        return self.parameters(z)[: len(self.model.parameters)]

    def attached(self, parameters: FloatArray) -> tuple[AttachedEffect, ...]:
        """Return the effects with their sizes, from the vector that `parameters` gives."""
        found, at = [], len(self.model.parameters)
        for one in self.effects:
            found.append(one.with_values(parameters[at : at + len(one.values)].tolist()))
            at += len(one.values)
        return tuple(found)

    def own(self, z: FloatArray, trial: int) -> FloatArray:
        """Return the scaled free initial states of one trial."""
        start = self.size + trial * self.own_size
        return z[start : start + self.own_size]

    def own_states(self, z: FloatArray) -> FloatArray:
        """Return the scaled free initial states of all trials, one after the other."""
        return z[self.size :]

    def initial_state(self, trial: int, own: FloatArray) -> FloatArray:
        """Return the initial state of one trial, shape (k,)."""
        free = len(self.states.free)
        found = self.states.state(trial, own[:free])
        spread = np.sqrt(self.data.trials[trial].count)
        for one, size in zip(self.deviations, own[free:], strict=False):
            if one.kind == "initial state" and one.output is not None:
                found[one.output] += size * one.sd / spread
        return found

    # --- problems made from this one --------------------------------------------------------------------------------

    def with_noise(self, noise: OutputNoise) -> Self:
        """Return the problem measured in units of another noise."""
        return replace(self, noise=noise)

    def with_effects(self, effects: Sequence[AttachedEffect], scales: Sequence[Scale]) -> Self:
        """Return the problem with further effects whose parameters are variables too."""
        priors = self.priors.with_effects(effects, scales, len(self.effects))
        return replace(self, effects=(*self.effects, *effects), priors=priors)

    def with_substeps(self, substeps: int) -> Self:
        """Return the problem with so many of the integrator's steps per sample."""
        return replace(self, drives=prepared(self.model, self.data, substeps))

    def with_measured(self, outputs: Sequence[FloatArray]) -> Self:
        """Return the problem with other measured outputs: the same experiment, had it come out differently."""
        trials = zip(self.data.trials, outputs, strict=True)
        data = replace(self.data, trials=tuple(replace(trial, outputs=one) for trial, one in trials))
        return replace(self, data=data)

    def on(self, data: Dataset) -> Self:
        """Return the problem of other trials, held against the same prior and in the same units of noise."""
        return replace(self, data=data, drives=prepared(self.model, data, self.substeps))

    def part(self, chosen: Sequence[int]) -> Self:
        """Return the problem of some of the trials."""
        trials = tuple(self.data.trials[index] for index in chosen)
        drives = tuple(self.drives[index] for index in chosen)
        seen = None if self.seen is None else tuple(self.seen[index] for index in chosen)
        return replace(self, data=replace(self.data, trials=trials), drives=drives, seen=seen)

    def with_seen(self, seen: Sequence[FloatArray]) -> Self:
        """Return the problem in which some samples of every trial are withheld: (n,) per trial, 1 for what counts."""
        return replace(self, seen=tuple(seen))

    def beginning(self, share: float) -> Self:
        """Return the problem of the first part of every trial, not shorter than a few samples."""
        trials, drives = [], []
        for trial, drive in zip(self.data.trials, self.drives, strict=True):
            length = len(trial.time_s)
            trials.append(trial.first(min(length, max(round(share * length), FEWEST_SAMPLES))))
            drives.append(_cut(drive, trials[-1]))
        data = replace(self.data, trials=tuple(trials))
        return replace(self, data=data, drives=tuple(drives), short=True, simulations=Simulations())

    def refined(self, z: FloatArray) -> Self:
        """Return the problem with as many of the integrator's steps as the widest trials ask for at `z`."""
        parameters = self.parameters(z)
        trials = self.data.trials
        widest = sorted(
            range(len(trials)),
            key=lambda index: -float(np.max(np.ptp(trials[index].outputs, axis=0) / self.spread)),
        )
        needed = max(
            suggest_substeps(
                self.model,
                trials[index].time_s,
                trials[index].inputs,
                parameters=parameters[: len(self.model.parameters)],
                condition=trials[index].condition,
                initial_state=self.initial_state(index, self.own(z, index)),
                effects=self.attached(parameters),
                most=_MOST_SUBSTEPS,
            )
            for index in widest[:_PROBED_TRIALS]
        )
        return self if needed == self.substeps else self.with_substeps(needed)

    # --- simulation and residuals -----------------------------------------------------------------------------------

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one trial; None where they are not finite."""
        outputs = self._simulated(parameters, trial, own)
        if outputs is None or not self.deviations:
            return outputs
        data = self.data.trials[trial]
        return deviated(outputs, data.time_s, self.deviations, own[len(self.states.free) :], data.count)

    def _simulated(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        stop_if_told()
        effects, data, laid_out = self.attached(parameters), self.data.trials[trial], self.drives[trial]
        parameters = parameters[: len(self.model.parameters)]
        condition, start = data.condition, self.initial_state(trial, own)
        deviating = own[len(self.states.free) :]
        drive = driven(laid_out, self.deviations, deviating, data.count)
        if any(one.effect.kind == "output" for one in effects):
            inside = tuple(one for one in effects if one.effect.kind != "output")
            same = tuple((id(one.effect), one.site, one.values) for one in inside)
            before = self.simulations.get(  # effects at outputs share what is before them
                (id(laid_out), parameters.tobytes(), start.tobytes(), deviating.tobytes(), same),
                lambda: simulate_unfiltered(
                    self.model,
                    drive,
                    parameters=parameters,
                    condition=condition,
                    initial_state=start,
                    effects=inside,
                ),
            )
            found = filtered(self.model, before, effects)
            return found.outputs if found.finite else None
        simulation = simulate(
            self.model,
            data.time_s,
            drive,
            parameters=parameters,
            condition=condition,
            initial_state=start,
            effects=effects,
        )
        if not effects:
            self.simulations.count(finite=simulation.finite)
        return simulation.outputs if simulation.finite else None

    def simulated(self, z: FloatArray) -> list[FloatArray]:
        """Return the outputs of every trial.

        Raises
        ------
        FitError
            The model leaves the finite numbers.
        """
        parameters = self.parameters(z)
        found = []
        for index, trial in enumerate(self.data.trials):
            outputs = self.simulate(parameters, index, self.own(z, index))
            if outputs is None:
                raise FitError(
                    f"model {self.model.name} leaves the finite numbers in {trial.label}",
                    hint="check the units of its parameters and inputs, the sign of forces that should resist motion, "
                    "and how its states begin",
                )
            found.append(outputs)
        return found

    def whiten(self, weighted: FloatArray, trial: int) -> FloatArray:
        """Return weighted values (n, m) of a trial as multiples of its noise, white."""
        if self.noise.whiten is None:
            return weighted
        return self.noise.whiten(weighted, self.data.trials[trial].count)

    def trial_residual(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return measured minus simulated of one trial in units of its noise, white, flat; None where not finite.

        Behind it stand the first samples' residuals, where a state that begins there is free.
        """
        outputs = self.simulate(parameters, trial, own)
        if outputs is None:
            return None
        residual = (self.data.trials[trial].outputs - outputs) * self.noise.weights
        # a simulation on its way to infinity must not overflow when it is squared
        huge = self._huge
        residual = self.whiten(np.clip(residual, -huge, huge), trial)
        if self.seen is not None:
            residual = residual * self.seen[trial][: len(residual), None]
        residual = residual.ravel()
        return np.concatenate([residual, self._behind(trial, own)])

    def _behind(self, trial: int, own: FloatArray) -> FloatArray:
        """Return what first samples and the spread of deviations have against the trial's own variables."""
        states = len(self.states.free)
        return np.concatenate([self.states.read_residual(trial, own[:states]), own[states:]])

    def finite_residuals(self, z: FloatArray) -> list[FloatArray] | None:
        """Return the residual of every trial; None where a simulation is not finite."""
        parameters, found = self.parameters(z), []
        for index in range(len(self.data.trials)):
            residual = self.trial_residual(parameters, index, self.own(z, index))
            if residual is None:
                return None
            found.append(residual)
        return found

    def residuals(self, z: FloatArray) -> list[FloatArray]:
        """Return the residual of every trial, huge where the simulation is not finite."""
        parameters, found = self.parameters(z), []
        for index, trial in enumerate(self.data.trials):
            own = self.own(z, index)
            residual = self.trial_residual(parameters, index, own)
            if residual is None:
                huge = np.full(trial.outputs.size, self._huge)
                residual = np.concatenate([huge, self._behind(index, own)])
            found.append(residual)
        return found

    def squares(self, z: FloatArray, residual: Sequence[FloatArray] | None = None) -> float:
        """Return the sum of squared residuals (or take them as known), prior included."""
        prior = self.priors.residual(z)
        residual = self.residuals(z) if residual is None else residual
        return float(prior @ prior) + sum(float(part @ part) for part in residual)

    def misfit(self, z: FloatArray) -> float:
        """Return the root mean square of the residuals, without prior."""
        samples = sum(trial.outputs.size for trial in self.data.trials)
        return float(np.sqrt(sum(float(part @ part) for part in self.residuals(z)) / samples))


def prepared(model: Model, data: Dataset, substeps: int) -> tuple[Drive, ...]:
    """Return the inputs of every trial on the integrator's steps."""
    return tuple(prepare(model, trial.time_s, trial.inputs, substeps) for trial in data.trials)


def _cut(drive: Drive, trial: FitTrial) -> Drive:
    """Return the inputs of the first part of a trial."""
    steps = (len(trial.time_s) - 1) * drive.substeps
    last = drive.u[steps, 0] if steps < len(drive.u) else drive.u_last
    return replace(drive, time_s=trial.time_s, steps_s=drive.steps_s[:steps], u=drive.u[:steps], u_last=last)
