"""A model with effects beside measured trials: where a search begins, and how residuals depend on the variables."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.errors import FitError
from labrun.fit.dataset import Dataset
from labrun.fit.priors import Priors, changed
from labrun.fit.residuals import OutputNoise, Residuals, prepared
from labrun.models import Model, simulate

_STEP = 1e-4
"""Central differences, in units of each variable's scale: error about 1e-8, well below any residual."""


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


def difference_quotient(
    residual: Callable[[float], FloatArray | None],
    centre: float,
    base: FloatArray,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    central: bool = True,
) -> FloatArray:
    """Return the derivative at `centre` by differences, inside bounds.

    To both sides if `central`, else to one; to the other side alone where the simulation is not finite, zero where it
    is so nowhere. `base`: the residual at `centre`.
    """
    before, after = max(centre - _STEP, low), min(centre + _STEP, high)
    ahead = residual(after) if after > centre else None
    if ahead is not None and not central:
        return (ahead - base) / (after - centre)
    behind = residual(before) if before < centre else None
    if ahead is not None and behind is not None:
        return (ahead - behind) / (after - before)
    if ahead is not None:
        return (ahead - base) / (after - centre)
    if behind is not None:
        return (base - behind) / (centre - before)
    return np.zeros_like(base)


def columns(found: Sequence[FloatArray], rows: int) -> FloatArray:
    """Return columns side by side, (rows, 0) if there are none."""
    return np.column_stack(found) if found else np.empty((rows, 0))


_GUESS_SUBSTEPS = 4
_GUESS_ROUNDS = 3
_LOST = 1e3
"""Scaled, beyond which a guess says that the outputs hardly depend on how that state begins."""
_AWAY = 1e-3
"""Scaled, where free states are put to see which of them change."""


@dataclass(frozen=True, eq=False)
class Problem(Residuals):
    """One model with effects and its trials: its residuals, their derivatives, and where a search begins."""

    @classmethod
    def of(
        cls,
        model: Model,
        data: Dataset,
        *,
        prior_weight: float = 1.0,
        substeps: int | None = None,
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
        priors = Priors.of(model, weight=prior_weight)
        spread = channel_spread(data)
        drives = prepared(model, data, _GUESS_SUBSTEPS if substeps is None else substeps)
        made = cls(data, model, (), priors, OutputNoise(1.0 / spread), spread, drives)
        return made if substeps is not None else made.refined(made.begin())

    def begin(self) -> FloatArray:
        """Return `z` of the stated parameters, initial states guessed."""
        return np.concatenate([self.priors.stated, self.guess(self.priors.values)])

    def jacobian(
        self,
        z: FloatArray,
        residual: list[FloatArray] | None = None,
        *,
        central: bool = True,
        moving: NDArray[np.bool_] | None = None,
        beside: Jacobian | None = None,
    ) -> Jacobian:
        """Return residuals (or take them as known) and their derivatives by the scaled variables.

        Differences to one side only cost half as much, and are good enough to find the way. Derivatives by shared
        variables that are not `moving` (all are, if None) are left at zero.

        Parameters
        ----------
        beside
            Derivatives near `z` by the first of the shared variables, and by the trials' own, that are taken as they
            are: only those by the variables behind them are computed.
        """
        residual = self.residuals(z) if residual is None else residual
        parameters, shared, own = self.parameters(z), [], []
        for index, base in enumerate(residual):
            start = self.own(z, index)
            if beside is not None:
                known = beside.shared[index]
                behind = range(known.shape[1], self.size)
                added = [self._by_parameter(parameters, index, start, one, base, False) for one in behind]
                shared.append(np.column_stack([known, *added]))
                continue
            by_parameter = [
                self._by_parameter(parameters, index, start, variable, base, central)
                if moving is None or moving[variable]
                else np.zeros_like(base)
                for variable in range(self.size)
            ]
            by_state = [
                self._by_state(parameters, index, start, variable, base, central)
                for variable in range(self.own_size)
            ]
            shared.append(columns(by_parameter, len(base)))
            own.append(columns(by_state, len(base)))
        return Jacobian(shared, own if beside is None else beside.own, residual)

    def guess(self, parameters: FloatArray) -> FloatArray:
        """Return free initial states, scaled, one trial after the other, from the first samples of each trial.

        A few Gauss-Newton steps on a short beginning, where a trial depends almost linearly on how it begins. A state
        that never changes is no beginning but something that the trial has of its own: the whole of it tells.
        """
        short, constant = self.beginning(0.0), self.constant_states
        moving = [place for place in range(len(self.states.free)) if place not in constant]
        guesses = []
        for index, trial in enumerate(short.data.trials):
            own = np.zeros(self.own_size)
            for place, state in enumerate(self.states.free):
                column = self.states.output_of(state)
                own[place] = 0.0 if column is None else trial.outputs[0, column] / self.states.scale[place]
            seen = own.copy()
            for _ in range(_GUESS_ROUNDS if moving else 0):
                base = short.trial_residual(parameters, index, own)
                if base is None:
                    break
                slopes = [short._by_state(parameters, index, own, place, base, False) for place in moving]
                own[moving] -= np.linalg.lstsq(np.column_stack(slopes), base, rcond=1e-8)[0]
            own = np.where(np.abs(own) < _LOST, own, seen)
            guesses.append(self._with_constant(parameters, index, own) if constant else own)
        return np.concatenate(guesses) if guesses else np.empty(0)

    @cached_property
    def constant_states(self) -> tuple[int, ...]:
        """Places, among the free initial states, of those that never change."""
        if not self.states.free:
            return ()
        parameters, away = self.priors.values, np.full(self.own_size, _AWAY)
        course = simulate(
            self.model,
            self.data.trials[0].time_s,
            self.drives[0],
            parameters=parameters[: len(self.model.parameters)],
            condition=self.data.trials[0].condition,
            initial_state=self.initial_state(0, away),
        ).states[:, list(self.states.free)]
        return tuple(np.flatnonzero(np.all(course == course[0], axis=0)).tolist())

    def _with_constant(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray:
        """Return a trial's own variables with those that never change as the whole trial has them."""
        from scipy.optimize import least_squares

        places = list(self.constant_states)

        def residual(values: FloatArray) -> FloatArray:
            found = self.trial_residual(parameters, trial, changed(own, places, values))
            return np.full(self.data.trials[trial].outputs.size, self._huge) if found is None else found

        if self.trial_residual(parameters, trial, own) is None:
            return own
        return changed(own, places, least_squares(residual, own[places]).x)

    def _by_parameter(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        variable: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        place, scale = self.priors.free[variable], self.priors.scale[variable]
        return difference_quotient(
            lambda value: self.trial_residual(changed(parameters, place, value * scale), trial, own),
            float(parameters[place] / scale),
            base,
            float(self.priors.lower[variable]),
            float(self.priors.upper[variable]),
            central=central,
        )

    def _by_state(
        self,
        parameters: FloatArray,
        trial: int,
        own: FloatArray,
        variable: int,
        base: FloatArray,
        central: bool,
    ) -> FloatArray:
        return difference_quotient(
            lambda value: self.trial_residual(parameters, trial, changed(own, variable, value)),
            float(own[variable]),
            base,
            central=central,
        )


def channel_spread(data: Dataset) -> FloatArray:
    """Return the standard deviation of each output over all trials, its size where it is constant, (m,)."""
    spread = []
    for column, output in enumerate(data.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in data.trials])
        size = float(np.std(values))
        if size <= 1e-12 * float(np.max(np.abs(values))):
            size = float(np.max(np.abs(values)))
        if size == 0.0:
            raise FitError(
                f"output {output.name!r} is zero throughout {data.name}: it says nothing about the model",
                hint="was the sensor connected? leave the output out of the model, or record it again",
            )
        spread.append(size)
    return np.array(spread)
