"""Residuals of a model against trials, and their derivatives, in the block structure that trials give."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.pieces import (
    FIRST_SAMPLES,
    beginning,
    channel_spread,
    cut_drive,
    output_of_state,
    prior_sigma,
    slope,
)

if TYPE_CHECKING:
    from labrun.effects import AttachedEffect
    from labrun.models import Drive, Model

FloatArray = NDArray[np.float64]

_STEP = 1e-4
"""Central differences, in units of each variable's scale: error about 1e-8, well below any residual."""
_HUGE = 1e3
"""Residual, in units of a channel's own spread, of a simulation that left the finite numbers."""
_GUESS_SUBSTEPS = 4
_GUESS_ROUNDS = 3
_MOST_SUBSTEPS = 64
_PROBED_TRIALS = 3
_LOOSE = 1e4
"""Standard deviation of a free parameter for the search, in units of its stated value."""


@dataclass(frozen=True)
class Blocks:
    """Derivatives of the weighted residuals, trial by trial.

    Attributes
    ----------
    shared : per trial (n*m, p)
        By the free parameters.
    own : per trial (n*m, q)
        By the trial's own free initial states.
    residual : per trial (n*m,)
    """

    shared: list[FloatArray]
    own: list[FloatArray]
    residual: list[FloatArray]


class Problem:
    """One model and its trials, in scaled variables.

    The vector `z` holds the free parameters, each divided by its scale, then the free initial states of the first
    trial, of the second, and so on. A trial's initial states change that trial alone, so that their derivatives
    cost one pair of simulations of one trial each, whatever the number of trials.

    Parameters
    ----------
    weights : (m,)
        One over the standard deviation that a residual of each output is measured in.
    prior_weight
        Factor on the prior's residuals; 0 leaves prior knowledge out.
    """

    def __init__(
        self,
        model: "Model",
        dataset: Dataset,
        *,
        weights: FloatArray | None = None,
        prior_weight: float = 1.0,
        effects: "Sequence[AttachedEffect]" = (),
        substeps: int | None = None,
    ) -> None:
        self.model = model.with_between({signal.name: signal.between for signal in dataset.inputs})
        self.dataset = dataset
        self.effects = effects
        self.prior_weight = prior_weight
        self.values = np.array([parameter.value for parameter in model.parameters], dtype=float)
        self.free = [index for index, parameter in enumerate(model.parameters) if parameter.tolerance != 0]
        self.names = [model.parameters[index].name for index in self.free]
        self.scale = np.array([abs(value) if value != 0 else 1.0 for value in self.values[self.free]])
        self.prior_sigma = np.array(
            [prior_sigma(model.parameters[index].tolerance, self.values[index]) for index in self.free]
        )
        # the slightest pull to the stated value: where the data say nothing, a search must not wander off
        self.pull_sigma = np.where(np.isfinite(self.prior_sigma), self.prior_sigma, _LOOSE * self.scale)
        self.lower = np.array([model.parameters[index].lower for index in self.free]) / self.scale
        self.upper = np.array([model.parameters[index].upper for index in self.free]) / self.scale
        self.spread = channel_spread(dataset)
        self.weights = 1.0 / self.spread if weights is None else weights
        self.free_states = [
            state for state, name in enumerate(model.states) if model.initial.get(name, "free") == "free"
        ]
        self.state_scale = self._state_scale()
        self._first = [self._first_values(trial) for trial in dataset.trials]
        self.substeps = _GUESS_SUBSTEPS if substeps is None else substeps
        self._drives = self._prepared()
        if substeps is None:
            own = self.guess(self.values)
            self.refine_steps(np.concatenate([self.values[self.free] / self.scale, own]))

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.free)

    @property
    def own_size(self) -> int:
        """Number of free initial states of one trial."""
        return len(self.free_states)

    @property
    def samples(self) -> int:
        """Number of measured numbers in all."""
        return sum(trial.outputs.size for trial in self.dataset.trials)

    def with_weights(self, weights: FloatArray) -> "Problem":
        """Return the same problem with other weights of the outputs."""
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        other.weights = weights
        return other

    def beginning(self, share: float) -> "Problem":
        """Return the problem of the first part of every trial."""
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__)
        trials = tuple(beginning(trial, share) for trial in self.dataset.trials)
        other.dataset = replace(self.dataset, trials=trials)
        other._drives = [cut_drive(drive, trial) for drive, trial in zip(self._drives, trials, strict=True)]
        return other

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return all parameters of the model, in its order and units."""
        values = self.values.copy()
        values[self.free] = z[: self.size] * self.scale
        return values

    def own(self, z: FloatArray, trial: int) -> FloatArray:
        """Return the scaled free initial states of one trial."""
        start = self.size + trial * self.own_size
        return z[start : start + self.own_size]

    def initial_state(self, trial: int, own: FloatArray) -> FloatArray:
        """Return the initial state of one trial, shape (k,)."""
        names = [self.model.states[state] for state in self.free_states]
        free = dict(zip(names, own * self.state_scale, strict=True))
        condition = self.dataset.trials[trial].condition
        return self.model.initial_state(condition, first=self._first[trial], free=free)

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one trial; None where they are not finite."""
        from labrun.models import simulate

        data = self.dataset.trials[trial]
        simulation = simulate(
            self.model,
            data.time_s,
            self._drives[trial],
            parameters=parameters,
            condition=data.condition,
            initial_state=self.initial_state(trial, own),
            effects=self.effects,
        )
        outputs: FloatArray | None = simulation.outputs if simulation.finite else None
        return outputs

    def trial_residual(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return weighted measured minus simulated of one trial, flat; None where the simulation is not finite."""
        outputs = self.simulate(parameters, trial, own)
        if outputs is None:
            return None
        residual = ((self.dataset.trials[trial].outputs - outputs) * self.weights).ravel()
        # a simulation on its way to infinity must not overflow when it is squared
        limit = _HUGE * float(np.max(self.weights * self.spread))
        return np.clip(residual, -limit, limit)

    def residuals(self, z: FloatArray) -> list[FloatArray]:
        """Return the weighted residual of every trial, huge where the simulation is not finite."""
        parameters = self.parameters(z)
        found = []
        for index, trial in enumerate(self.dataset.trials):
            residual = self.trial_residual(parameters, index, self.own(z, index))
            found.append(
                np.full(trial.outputs.size, _HUGE * float(np.max(self.weights * self.spread)))
                if residual is None
                else residual
            )
        return found

    def prior_residual(self, z: FloatArray) -> FloatArray:
        """Return (stated value - value) / sigma of the free parameters; next to nothing where none was stated."""
        away: FloatArray = (self.values[self.free] - z[: self.size] * self.scale) / self.pull_sigma
        return self.prior_weight * away

    def misfit(self, z: FloatArray) -> float:
        """Return the root mean square of the weighted residuals, without prior."""
        return float(np.sqrt(sum(float(part @ part) for part in self.residuals(z)) / self.samples))

    def blocks(
        self,
        z: FloatArray,
        residual: list[FloatArray] | None = None,
        *,
        central: bool = True,
        moving: NDArray[np.bool_] | None = None,
    ) -> Blocks:
        """Return residuals (or take them as known) and their derivatives by the scaled variables.

        Differences to one side only cost half as much, and are good enough to find the way. Derivatives by shared
        variables that are not `moving` (all are, if None) are left at zero.
        """
        residual = self.residuals(z) if residual is None else residual
        parameters = self.parameters(z)
        shared, own = [], []
        for index, base in enumerate(residual):
            start = self.own(z, index)
            columns = [
                self._by_parameter(parameters, index, start, variable, base, central)
                if moving is None or moving[variable]
                else np.zeros_like(base)
                for variable in range(self.size)
            ]
            shared.append(np.column_stack(columns) if columns else np.empty((len(base), 0)))
            columns = [
                self._by_state(parameters, index, start, variable, base, central)
                for variable in range(self.own_size)
            ]
            own.append(np.column_stack(columns) if columns else np.empty((len(base), 0)))
        return Blocks(shared, own, residual)

    def _by_parameter(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        variable: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        place = self.free[variable]

        def residual(value: float) -> FloatArray | None:
            changed = parameters.copy()
            changed[place] = value * self.scale[variable]
            return self.trial_residual(changed, trial, own)

        centre = float(parameters[place] / self.scale[variable])
        low, high = float(self.lower[variable]), float(self.upper[variable])
        return slope(residual, centre, base, _STEP, low, high, central=central)

    def _by_state(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        variable: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        def residual(value: float) -> FloatArray | None:
            changed = own.copy()
            changed[variable] = value
            return self.trial_residual(parameters, trial, changed)

        return slope(residual, float(own[variable]), base, _STEP, central=central)

    def guess(self, parameters: FloatArray) -> FloatArray:
        """Return free initial states, scaled, one trial after the other, from the first samples of each trial.

        A few Gauss-Newton steps on a short beginning, where a trial depends almost linearly on how it begins.
        """
        short = self.beginning(0.0)
        guesses = []
        for index, trial in enumerate(short.dataset.trials):
            own = np.zeros(self.own_size)
            for place, state in enumerate(self.free_states):
                column = output_of_state(self.model, self.model.states[state])
                own[place] = 0.0 if column is None else trial.outputs[0, column] / self.state_scale[place]
            for _ in range(_GUESS_ROUNDS if self.own_size else 0):
                base = short.trial_residual(parameters, index, own)
                if base is None:
                    break
                slopes = np.column_stack(
                    [
                        short._by_state(parameters, index, own, place, base, False)
                        for place in range(self.own_size)
                    ]
                )
                own = own - np.linalg.lstsq(slopes, base, rcond=1e-8)[0]
            guesses.append(own)
        return np.concatenate(guesses) if guesses else np.empty(0)

    def _first_values(self, trial: FitTrial) -> dict[str, float]:
        means = np.mean(trial.outputs[:FIRST_SAMPLES], axis=0)
        return {output.name: float(mean) for output, mean in zip(self.model.outputs, means, strict=True)}

    def _state_scale(self) -> FloatArray:
        """Return a typical size of each free state: of the output it is, or of an output per sample-rate-free time."""
        sizes = []
        for state in self.free_states:
            column = output_of_state(self.model, self.model.states[state])
            sizes.append(float(np.max(self.spread)) if column is None else float(self.spread[column]))
        return np.array(sizes)

    def refine_steps(self, z: FloatArray) -> bool:
        """Shorten the integrator's steps if the widest trials ask for it at `z`; tell whether they did."""
        from labrun.models import suggest_substeps

        parameters = self.parameters(z)
        trials = self.dataset.trials
        widest = sorted(
            range(len(trials)),
            key=lambda index: -float(np.max(np.ptp(trials[index].outputs, axis=0) / self.spread)),
        )
        needed = max(
            suggest_substeps(
                self.model,
                trials[index].time_s,
                trials[index].inputs,
                parameters=parameters,
                condition=trials[index].condition,
                initial_state=self.initial_state(index, self.own(z, index)),
                effects=self.effects,
                most=_MOST_SUBSTEPS,
            )
            for index in widest[:_PROBED_TRIALS]
        )
        shortened = needed > self.substeps
        if needed != self.substeps:
            self.substeps = needed
            self._drives = self._prepared()
        return shortened

    def _prepared(self) -> "list[Drive]":
        """Lay out every trial's inputs on the integrator's steps, once for all simulations of it."""
        from labrun.models import prepare

        return [
            prepare(self.model, trial.time_s, trial.inputs, self.substeps) for trial in self.dataset.trials
        ]
