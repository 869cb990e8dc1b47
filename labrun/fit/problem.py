"""A model with effects and measured trials: residuals in units of noise, derivatives, starting values."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray, IntArray
from labrun.effects import AttachedEffect, Scale
from labrun.errors import FitError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.simulations import Each, Simulations, one_by_one, stop_if_told
from labrun.fit.variables import Deviation, InitialStates, Priors, changed, deviated, driven
from labrun.models import Drive, Model, filtered, prepare, simulate, simulate_unfiltered, suggest_substeps

FEWEST_SAMPLES = 25
"""A beginning of a trial is at least this long, if the trial is."""
_HUGE = 1e3
"""Residual, in units of a channel's own spread, of a simulation that left the finite numbers."""
_MOST_SUBSTEPS = 64
_PROBED_TRIALS = 3
_READ = 0.01
"""Part of an output's spread that a state read from its first samples is taken to be uncertain by, noise unknown."""
_STEP = 1e-4
"""Central differences, in units of each variable's scale: error about 1e-8, well below any residual."""
_GUESS_SUBSTEPS = 4
_GUESS_ROUNDS = 3
_LOST = 1e3
"""Scaled, beyond which a guess says that the outputs hardly depend on how that state begins."""
_AWAY = 1e-3
"""Scaled, where free states are put to see which of them change."""


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


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of the residuals, trial by trial.

    Attributes
    ----------
    shared : per trial (rows, p)
        By the variables that all trials share.
    own : per trial (rows, q)
        By the trial's own free initial states.
    residual : per trial (rows,)
    """

    shared: list[FloatArray]
    own: list[FloatArray]
    residual: list[FloatArray]

    def part(self, chosen: Sequence[int]) -> "Jacobian":
        """Return the derivatives of some of the trials."""
        return Jacobian(*([of[index] for index in chosen] for of in (self.shared, self.own, self.residual)))


@dataclass(frozen=True, eq=False)
class Problem:
    """One model with effects and its trials, by scaled variables; nothing in it changes.

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
    each
        How its trials are simulated: one after the other, or side by side.
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
    each: Each = one_by_one

    @classmethod
    def of(
        cls, model: Model, data: Dataset, *, prior_weight: float = 1.0, substeps: int | None = None
    ) -> Self:
        """Hold a model against data, each output in units of its own spread.

        Parameters
        ----------
        prior_weight
            Factor on the prior's residuals; 0 leaves prior knowledge out.
        substeps
            Steps of the integrator per sample; as many as the stated parameters ask for if None.
        """
        model = model.with_between({signal.name: signal.between for signal in data.inputs})
        priors, spread = Priors.of(model, weight=prior_weight), channel_spread(data)
        drives = prepared(model, data, substeps or _GUESS_SUBSTEPS)
        made = cls(data, model, (), priors, OutputNoise(1.0 / spread), spread, drives)
        return made if substeps is not None else made.refined(made.begin())

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
        """Number of residual rows after the samples of a trial: initial states and deviations."""
        return len(self.states.read) + len(self.deviations)

    @property
    def substeps(self) -> int:
        """Steps of the integrator per sample, where most of them are taken."""
        return max(drive.substeps for drive in self.drives)

    @property
    def steps(self) -> tuple[IntArray, ...]:
        """Steps of the integrator in every interval between samples, trial by trial."""
        return tuple(drive.grid.counts for drive in self.drives)

    @cached_property
    def states(self) -> InitialStates:
        """How the trials begin."""
        sd = self.spread * _READ if self.noise.whiten is None else 1.0 / self.noise.weights
        return InitialStates(self.model, self.data.trials, self.spread, sd, self.read_free, self.short)

    @cached_property
    def _huge(self) -> float:
        return _HUGE * float(np.max(self.noise.weights * self.spread))

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return all parameters of model and effects, in their order and units."""
        return self.priors.parameters(z)

    def model_parameters(self, z: FloatArray) -> FloatArray:
        """Return the parameters of the model alone."""
        return self.parameters(z)[: len(self.model.parameters)]

    def attached(self, parameters: FloatArray) -> tuple[AttachedEffect, ...]:
        """Return the effects with their sizes, from the vector that `parameters` gives."""
        columns, at = [], len(self.model.parameters)
        for effect in self.effects:
            columns.append(effect.with_values(parameters[at : at + len(effect.values)].tolist()))
            at += len(effect.values)
        return tuple(columns)

    def own(self, z: FloatArray, trial: int) -> FloatArray:
        """Return the scaled free initial states of one trial, and its deviations."""
        start = self.size + trial * self.own_size
        return z[start : start + self.own_size]

    def own_states(self, z: FloatArray) -> FloatArray:
        """Return those of all trials, one after the other."""
        return z[self.size :]

    def initial_state(self, trial: int, own: FloatArray) -> FloatArray:
        """Return the initial state of one trial, shape (k,)."""
        free = len(self.states.free)
        state = self.states.state(trial, own[:free])
        spread = np.sqrt(self.data.trials[trial].count)
        for deviation, size in zip(self.deviations, own[free:], strict=False):
            if deviation.kind == "initial state" and deviation.output is not None:
                state[deviation.output] += size * deviation.sd / spread
        return state

    # --- problems made from this one --------------------------------------------------------------------------------

    def with_noise(self, noise: OutputNoise) -> Self:
        """Return the problem measured in units of another noise."""
        return replace(self, noise=noise)

    def with_effects(self, effects: Sequence[AttachedEffect], scales: Sequence[Scale]) -> Self:
        """Return the problem with further effects whose parameters are variables too."""
        priors = self.priors.with_effects(effects, scales, len(self.effects))
        return replace(self, effects=(*self.effects, *effects), priors=priors)

    def with_substeps(self, substeps: int) -> Self:
        """Return the problem with so many of the integrator's steps per sample, in every trial alike."""
        return self.with_steps([substeps] * len(self.drives))

    def with_steps(self, steps: Sequence[int | IntArray]) -> Self:
        """Return the problem with so many of the integrator's steps per sample, trial by trial; itself if it has them.

        A trial may have another number in each interval between its samples.
        """
        drives = list(self.drives)
        for index, (trial, count) in enumerate(zip(self.data.trials, steps, strict=True)):
            if np.any(drives[index].grid.counts != count):
                drives[index] = prepare(self.model, trial.time_s, trial.inputs, count)
        return self.with_drives(drives)

    def with_drives(self, drives: Sequence[Drive]) -> Self:
        """Return the problem with its inputs on other steps of the integrator; itself if they are its own."""
        same = all(first is other for first, other in zip(self.drives, drives, strict=True))
        return self if same else replace(self, drives=tuple(drives))

    def in_steps_of(self, other: "Problem") -> Self:
        """Return the problem in the steps of another one of the same trials."""
        return replace(self, drives=other.drives)

    def with_measured(self, outputs: Sequence[FloatArray]) -> Self:
        """Return the problem with other measured outputs: the same experiment, had it come out differently."""
        pairs = zip(self.data.trials, outputs, strict=True)
        trials = tuple(replace(trial, outputs=output) for trial, output in pairs)
        return replace(self, data=replace(self.data, trials=trials))

    def with_seen(self, seen: Sequence[FloatArray]) -> Self:
        """Return the problem in which some samples of every trial are withheld: (n,) per trial, 1 for what counts."""
        return replace(self, seen=tuple(seen))

    def on(self, data: Dataset) -> Self:
        """Return the problem of other trials, held against the same prior and in the same units of noise."""
        return replace(self, data=data, drives=prepared(self.model, data, self.substeps))

    def part(self, chosen: Sequence[int]) -> Self:
        """Return the problem of some of the trials."""
        trials = tuple(self.data.trials[index] for index in chosen)
        drives = tuple(self.drives[index] for index in chosen)
        seen = None if self.seen is None else tuple(self.seen[index] for index in chosen)
        return replace(self, data=replace(self.data, trials=trials), drives=drives, seen=seen)

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
        parameters, trials = self.parameters(z), self.data.trials
        width = [float(np.max(np.ptp(trial.outputs, axis=0) / self.spread)) for trial in trials]
        widest = sorted(range(len(trials)), key=lambda index: -width[index])
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
        parameters, start = parameters[: len(self.model.parameters)], self.initial_state(trial, own)
        deviating = own[len(self.states.free) :]
        drive = driven(laid_out, self.deviations, deviating, data.count)
        if any(effect.effect.kind == "output" for effect in effects):
            inside = tuple(effect for effect in effects if effect.effect.kind != "output")
            same = tuple((id(effect.effect), effect.site, effect.values) for effect in inside)
            before = self.simulations.get(  # effects at outputs share what is before them
                (id(laid_out), parameters.tobytes(), start.tobytes(), deviating.tobytes(), same),
                lambda: simulate_unfiltered(
                    self.model, drive, parameters=parameters, condition=data.condition, initial_state=start,
                    effects=inside,
                ),
                laid_out,
            )  # fmt: skip
            simulation = filtered(self.model, before, effects)
            return simulation.outputs if simulation.finite else None
        simulation = simulate(
            self.model, data.time_s, drive, parameters=parameters, condition=data.condition, initial_state=start,
            effects=effects,
        )  # fmt: skip
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
        parameters, simulated = self.parameters(z), []
        for index, trial in enumerate(self.data.trials):
            outputs = self.simulate(parameters, index, self.own(z, index))
            if outputs is None:
                raise FitError(
                    f"model {self.model.name} leaves the finite numbers in {trial.label}",
                    hint="check the units of its parameters and inputs, the sign of forces that should resist motion, "
                    "and how its states begin",
                )
            simulated.append(outputs)
        return simulated

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
        residual = self.whiten(np.clip(residual, -self._huge, self._huge), trial)
        if self.seen is not None:
            residual = residual * self.seen[trial][: len(residual), None]
        return np.concatenate([residual.ravel(), self._behind(trial, own)])

    def _behind(self, trial: int, own: FloatArray) -> FloatArray:
        """Return what first samples and the spread of deviations have against the trial's own variables."""
        states = len(self.states.free)
        return np.concatenate([self.states.read_residual(trial, own[:states]), own[states:]])

    def finite_residuals(self, z: FloatArray) -> list[FloatArray] | None:
        """Return the residual of every trial; None where a simulation is not finite."""
        parameters, residuals = self.parameters(z), []
        for index in range(len(self.data.trials)):
            residual = self.trial_residual(parameters, index, self.own(z, index))
            if residual is None:
                return None
            residuals.append(residual)
        return residuals

    def residuals(self, z: FloatArray) -> list[FloatArray]:
        """Return the residual of every trial, huge where the simulation is not finite."""
        parameters = self.parameters(z)

        def residual(index: int) -> FloatArray:
            own = self.own(z, index)
            moved = self.trial_residual(parameters, index, own)
            if moved is not None:
                return moved
            huge = np.full(self.data.trials[index].outputs.size, self._huge)
            return np.concatenate([huge, self._behind(index, own)])

        return self.each(residual, range(len(self.data.trials)))

    def squares(self, z: FloatArray, residual: Sequence[FloatArray] | None = None) -> float:
        """Return the sum of squared residuals (or take them as known), prior included."""
        prior = self.priors.residual(z)
        residual = self.residuals(z) if residual is None else residual
        return float(prior @ prior) + sum(float(part @ part) for part in residual)

    def misfit(self, z: FloatArray) -> float:
        """Return the root mean square of the residuals, without prior."""
        samples = sum(trial.outputs.size for trial in self.data.trials)
        return float(np.sqrt(sum(float(part @ part) for part in self.residuals(z)) / samples))

    # --- derivatives ------------------------------------------------------------------------------------------------

    def jacobian(
        self,
        z: FloatArray,
        residual: list[FloatArray] | None = None,
        *,
        central: bool = True,
        moving: NDArray[np.bool_] | None = None,
        given_jacobian: Jacobian | None = None,
    ) -> Jacobian:
        """Return residuals (or take them as known) and their derivatives by the scaled variables.

        Differences to one side only cost half as much, and are good enough to find the way. Derivatives by shared
        variables that are not `moving` (all are, if None) are left at zero.

        Parameters
        ----------
        given_jacobian
            Derivatives near `z` by the first of the shared variables, and by the trials' own, that are taken as they
            are: only those by the variables behind them are computed.
        """
        residual = self.residuals(z) if residual is None else residual
        parameters = self.parameters(z)

        def slopes(index: int) -> tuple[FloatArray, FloatArray]:
            base, start = residual[index], self.own(z, index)
            if given_jacobian is not None:
                known = given_jacobian.shared[index]
                behind = range(known.shape[1], self.size)
                added = [self._by_parameter(parameters, index, start, other, base, False) for other in behind]
                return np.column_stack([known, *added]), given_jacobian.own[index]
            by_parameter = [
                self._by_parameter(parameters, index, start, variable, base, central)
                if moving is None or moving[variable]
                else np.zeros_like(base)
                for variable in range(self.size)
            ]
            by_state = [
                self._by_state(parameters, index, start, column, base, central)
                for column in range(self.own_size)
            ]
            return _columns(by_parameter, len(base)), _columns(by_state, len(base))

        derivatives = self.each(slopes, range(len(residual)))
        return Jacobian([shared for shared, _ in derivatives], [own for _, own in derivatives], residual)

    def _by_parameter(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        variable: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        priors = self.priors
        index, scale = priors.free[variable], priors.scale[variable]
        return _difference_quotient(
            lambda value: self.trial_residual(changed(parameters, index, value * scale), trial, own),
            float(parameters[index] / scale),
            base,
            (float(priors.lower[variable]), float(priors.upper[variable])),
            central,
        )

    def _by_state(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        state_index: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        return _difference_quotient(
            lambda value: self.trial_residual(parameters, trial, changed(own, state_index, value)),
            float(own[state_index]),
            base,
            (-math.inf, math.inf),
            central,
        )

    # --- where a search begins --------------------------------------------------------------------------------------

    def begin(self) -> FloatArray:
        """Return `z` of the stated parameters, initial states guessed."""
        return np.concatenate([self.priors.stated, self.guess(self.priors.values)])

    def guess(self, parameters: FloatArray) -> FloatArray:
        """Return free initial states, scaled, one trial after the other, from the first samples of each trial.

        A few Gauss-Newton steps on a short beginning, where a trial depends almost linearly on how it begins. A state
        that never changes is no beginning but something that the trial has of its own: the whole of it tells.
        """
        short, constant = self.beginning(0.0), self.constant_states
        moving = [index for index in range(len(self.states.free)) if index not in constant]
        guesses = []
        for index, trial in enumerate(short.data.trials):
            own = np.zeros(self.own_size)
            for row, state in enumerate(self.states.free):
                column = self.states.output_of(state)
                own[row] = 0.0 if column is None else trial.outputs[0, column] / self.states.scale[row]
            seen = own.copy()
            for _ in range(_GUESS_ROUNDS if moving else 0):
                base = short.trial_residual(parameters, index, own)
                if base is None:
                    break
                slopes = [
                    short._by_state(parameters, index, own, state_index, base, False)
                    for state_index in moving
                ]
                own[moving] -= np.linalg.lstsq(np.column_stack(slopes), base, rcond=1e-8)[0]
            own = np.where(np.abs(own) < _LOST, own, seen)
            guesses.append(self._with_constant(parameters, index, own) if constant else own)
        return np.concatenate(guesses) if guesses else np.empty(0)

    @cached_property
    def constant_states(self) -> tuple[int, ...]:
        """Places, among the free initial states, of those that never change."""
        if not self.states.free:
            return ()
        first, start = self.data.trials[0], self.initial_state(0, np.full(self.own_size, _AWAY))
        course = simulate(
            self.model, first.time_s, self.drives[0], parameters=self.priors.values[: len(self.model.parameters)],
            condition=first.condition, initial_state=start,
        ).states[:, list(self.states.free)]  # fmt: skip
        return tuple(np.flatnonzero(np.all(course == course[0], axis=0)).tolist())

    def _with_constant(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray:
        """Return a trial's own variables with those that never change as the whole trial has them."""
        from scipy.optimize import least_squares

        places = list(self.constant_states)

        def residual(values: FloatArray) -> FloatArray:
            moved = self.trial_residual(parameters, trial, changed(own, places, values))
            return np.full(self.data.trials[trial].outputs.size, self._huge) if moved is None else moved

        if self.trial_residual(parameters, trial, own) is None:
            return own
        return changed(own, places, least_squares(residual, own[places]).x)


def prepared(model: Model, data: Dataset, substeps: int) -> tuple[Drive, ...]:
    """Return the inputs of every trial on the integrator's steps."""
    return tuple(prepare(model, trial.time_s, trial.inputs, substeps) for trial in data.trials)


def channel_spread(data: Dataset) -> FloatArray:
    """Return the standard deviation of each output over all trials, its size where it is constant, (m,)."""
    spread = []
    for column, output in enumerate(data.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in data.trials])
        size, largest = float(np.std(values)), float(np.max(np.abs(values)))
        if size <= 1e-12 * largest:
            size = largest
        if size == 0.0:
            raise FitError(
                f"output {output.name!r} is zero throughout {data.name}: it says nothing about the model",
                hint="was the sensor connected? leave the output out of the model, or record it again",
            )
        spread.append(size)
    return np.array(spread)


def _cut(drive: Drive, trial: FitTrial) -> Drive:
    """Return the inputs of the first part of a trial."""
    grid = drive.grid.beginning(len(trial.time_s))
    steps = int(grid.rows[-1])
    last = drive.u[steps, 0] if steps < len(drive.u) else drive.u_last
    return Drive(trial.time_s, drive.steps_s[:steps], drive.u[:steps], last, grid)


def _difference_quotient(
    residual: Callable[[float], FloatArray | None],
    centre: float,
    base: FloatArray,
    bounds: tuple[float, float],
    central: bool,
) -> FloatArray:
    """Return the derivative at `centre`, where the residual is `base`, by differences inside bounds.

    To both sides if `central`, else to one; to the other side alone where the simulation is not finite, zero where it
    is so nowhere.
    """
    before, after = max(centre - _STEP, bounds[0]), min(centre + _STEP, bounds[1])
    ahead = residual(after) if after > centre else None
    behind = residual(before) if before < centre and (central or ahead is None) else None
    if ahead is None and behind is None:
        return np.zeros_like(base)
    upper, above = (base, centre) if ahead is None else (ahead, after)
    lower, below = (base, centre) if behind is None else (behind, before)
    return (upper - lower) / (above - below)


def _columns(columns: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return columns side by side, (rows, 0) if there are none."""
    return np.column_stack(columns) if columns else np.empty((rows, 0))
