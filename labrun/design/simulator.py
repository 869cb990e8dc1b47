"""One candidate of a design, simulated: its geometry as the model's parameters, its gait as the model's inputs."""

import functools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.design.constraints import DesignConstraints, Margin, summary
from labrun.errors import PlanError, SpecError
from labrun.estimate import outside_text
from labrun.experiment import SIMULATION, Condition, Design, Experiment
from labrun.models import Model, load_model, simulate
from labrun.runner import MotionMaker, ObjectiveError, ObjectiveEvaluation
from labrun.search import Violations
from labrun.signals import Signals
from labrun.toml import ExpressionError, suggest

_UNFIT = "cannot be simulated: "
_REASONS = 3
"""So many different ones are told when nothing can be simulated."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """The simulation result of one candidate.

    Attributes
    ----------
    objectives
        By name; empty of a candidate that was not, or could not be, simulated.
    violations
        What it breaks. One that cannot be simulated breaks one constraint, by its whole size.
    period_s, duration_s
        Of its gait, and of the trial.
    signals
        Every channel over time, where they were asked for.
    margins
        How it stands to every constraint, where signals were asked for.
    """

    objectives: Mapping[str, float]
    violations: Violations
    period_s: float | None = None
    duration_s: float = 0.0
    signals: Signals | None = None
    margins: tuple[Margin, ...] = ()


@dataclass(frozen=True)
class Simulator:
    """Simulates candidates; travels to other processes, where it finds the model again.

    Attributes
    ----------
    experiment
        Of kind "design".
    model
        What `labrun.models.load_model` takes.
    """

    experiment: Experiment
    model: str

    @property
    def design(self) -> Design:
        """The table [design]."""
        if self.experiment.design is None:
            raise PlanError("the experiment has no table [design]", hint='it needs one with kind = "design"')
        return self.experiment.design

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels: not what `_parts` made."""
        return {"experiment": self.experiment, "model": self.model}

    def __call__(self, candidates: Sequence[Condition], *, keep: bool = False) -> list[Simulated]:
        """Simulate candidates; with `keep`, signals and margins of each are returned, whatever they violate.

        Raises
        ------
        SpecError, ModelError
            The file and the model do not fit together.
        """
        return [self._one(values, keep) for values in candidates]

    def parameters(self, values: Condition) -> dict[str, float]:
        """Return the model's parameters of a candidate, SI."""
        return {name: float(parameter(values)) for name, parameter in self.design.parameters.items()}

    @functools.cached_property
    def _parts(self) -> "_Parts":
        return _Parts(self.experiment, self.design, _loaded(self.model))

    @property
    def loaded(self) -> Model:
        """The model."""
        return self._parts.model

    def _one(self, values: Condition, keep: bool) -> Simulated:
        parts = self._parts
        broken = parts.constraints.violations(parts.constraints.before, values)
        if not broken.feasible and not keep:
            return Simulated({}, broken)
        try:
            return self._simulated(values, keep, broken)
        except _UnfitError as error:
            reason = f"{_UNFIT}{error}"
            return Simulated({}, Violations(broken.number + 1, broken.size + 1.0, (*broken.texts, reason)))

    def _simulated(self, values: Condition, keep: bool, broken: Violations) -> Simulated:
        parts, design = self._parts, self.design
        try:
            motion = parts.motions.motion(values)
            parameters = self.parameters(values)
            start = {name: float(expression(values)) for name, expression in design.initial.items()}
        except (PlanError, ExpressionError) as error:
            raise _UnfitError(str(error).splitlines()[0]) from error
        parts.require_within(parameters)
        count = max(2, round(motion.duration_s * design.rate_hz) + 1)
        time_s = np.linspace(0.0, motion.duration_s, count)
        commanded = motion.trajectory.at(time_s)
        inputs = (
            np.column_stack([commanded[:, column] for column in parts.columns])
            if parts.columns
            else (np.empty((count, 0)))
        )
        state = parts.model.initial_state(values)
        for name, value in start.items():
            state[parts.model.states.index(name)] = value
        simulated = simulate(
            parts.model, time_s, inputs,
            parameters=parameters, condition=values, initial_state=state, substeps=design.substeps,
        )  # fmt: skip
        if not simulated.finite:
            raise _UnfitError("its motion leaves the finite numbers")
        signals = parts.signals(time_s, simulated.outputs, values)
        names = {**values, **parts.summaries(signals)}
        after = parts.constraints.violations(parts.constraints.after, names)
        violations = Violations(
            broken.number + after.number, broken.size + after.size, (*broken.texts, *after.texts)
        )
        try:
            objectives = parts.objectives.evaluate({SIMULATION: signals}, motion, values)
        except ObjectiveError as error:
            raise _UnfitError(str(error).splitlines()[0]) from error
        return Simulated(
            objectives,
            violations,
            motion.period_s,
            motion.duration_s,
            signals if keep else None,
            tuple(parts.constraints.margins(names, parts.spans(signals))) if keep else (),
        )


class _UnfitError(Exception):
    """A candidate that cannot be simulated, and why."""


@functools.lru_cache(maxsize=4)
def _loaded(model: str) -> Model:
    return load_model(model)


class _Parts:
    """What is made once for all candidates."""

    def __init__(self, experiment: Experiment, design: Design, model: Model) -> None:
        self.model = model
        self.constraints = DesignConstraints(design)
        self.objectives = ObjectiveEvaluation(experiment)
        self.motions = MotionMaker(experiment)
        self._design = design
        self._bounds = {
            parameter.name: (parameter.lower, parameter.upper, parameter.unit)
            for parameter in model.parameters
        }
        self._units = [*(output.unit for output in model.outputs), *("1" for _ in design.channels)]
        outputs = [output.name for output in model.outputs]
        self._names = (*outputs, *design.channels)
        self._require_known(
            "parameters", design.parameters, [parameter.name for parameter in model.parameters]
        )
        self._require_known("initial", design.initial, list(model.states))
        self._require_known("signals", design.signals, [signal.name for signal in model.inputs])
        for name in design.channels:
            if name in outputs or name in design.variables:
                raise SpecError(
                    f"design.channels.{name}: the model has an output, or the design a variable, of this name",
                    hint="choose another",
                )
        for kind, channel in self.constraints.summaries:
            if channel not in self._names:
                raise SpecError(
                    f"design.where: {kind}_{channel} is of no channel",
                    hint=suggest(f"{kind}_{channel}", [f"{kind}_{name}" for name in self._names]),
                )
        joints = list(self.motions.joints)
        self.columns = []
        for signal in model.inputs:
            joint = design.signals.get(signal.name, signal.name).removeprefix("command.")
            if joint not in joints:
                raise SpecError(
                    f"the model's input {signal.name} is not a joint of the gait",
                    hint=f"name a joint after it, or write design.signals.{signal.name} = "
                    f'"command.JOINT"; the gait has {", ".join(joints) or "none"}',
                )
            self.columns.append(joints.index(joint))

    def _require_known(self, key: str, given: Mapping[str, object], known: list[str]) -> None:
        for name in given:
            if name not in known:
                raise SpecError(
                    f"design.{key}.{name}: model {self.model.name} has no such name",
                    hint=suggest(name, known),
                )

    def require_within(self, parameters: Mapping[str, float]) -> None:
        """Raise _UnfitError if a parameter makes no sense."""
        for name, value in parameters.items():
            low, high, unit = self._bounds[name]
            if not low <= value <= high:
                raise _UnfitError(
                    f"{name} = {outside_text(value, low, high)} {unit} is outside {low:g} ... {high:g}"
                )

    def signals(self, time_s: FloatArray, outputs: FloatArray, values: Condition) -> Signals:
        """Return the model's outputs, and the channels made of them."""
        names: dict[str, Any] = {**values, **dict(zip(self._names, outputs.T, strict=False))}
        columns = [outputs]
        for name, expression in self._design.channels.items():
            try:
                names[name] = np.broadcast_to(expression(names), time_s.shape)
            except ExpressionError as error:
                raise _UnfitError(f"design.channels.{name}: {error}") from error
            columns.append(names[name][:, None])
        return Signals(
            SIMULATION, self._names, tuple(self._units), time_s, np.column_stack(columns),
            rate_hz=self._design.rate_hz,
        )  # fmt: skip

    def summaries(self, signals: Signals) -> dict[str, float]:
        """Return the summaries that constraints name."""
        return {
            f"{kind}_{channel}": summary(kind, signals.column(channel))
            for kind, channel in sorted(self.constraints.summaries)
        }

    def spans(self, signals: Signals) -> dict[str, float]:
        """Return the range that every channel runs through of which constraints name summaries."""
        channels = {channel for _, channel in self.constraints.summaries}
        return {name: float(np.ptp(signals.column(name))) for name in channels}


_PROBES = 4096


def require_simulable(simulator: Simulator) -> float:
    """Return the share of the space that the constraints known beforehand allow.

    Raises
    ------
    PlanError
        They allow nothing of it, or nothing that was tried can be simulated.
    SpecError, ModelError
        The file and the model do not fit together.
    """
    from labrun.search import probes

    design = simulator.design
    parts = simulator._parts
    columns = probes(design, _PROBES)
    keep = np.ones(_PROBES, dtype=bool)
    excluded: list[tuple[float, str]] = []
    for constraint in parts.constraints.before:
        holds = np.broadcast_to(constraint.holds(columns), (_PROBES,))
        keep &= holds
        excluded.append((1.0 - float(holds.mean()), constraint.text))
    if not keep.any():
        shares = "".join(
            f"\n  {100 * share:.0f} % break: {text}" for share, text in sorted(excluded, reverse=True)
        )
        raise PlanError(
            f"nothing of the design space can be built: the constraints leave none of {_PROBES:,} points{shares}",
            hint="bounds and constraints exclude each other: widen the ranges of the variables, or loosen `where`",
        )
    chosen = np.flatnonzero(keep)[:8]
    tried = simulator(
        [{name: float(column[at]) for name, column in columns.items()} for at in chosen], keep=True
    )
    if not any(outcome.objectives for outcome in tried):
        reasons = Counter(outcome.violations.texts[-1].removeprefix(_UNFIT) for outcome in tried)
        message = "".join(f"\n  {count} x {reason}" for reason, count in reasons.most_common(_REASONS))
        if len(reasons) > _REASONS:
            message += f"\n  {len(reasons) - _REASONS} others like these"
        raise PlanError(
            f"the design cannot be simulated: none of {len(tried)} that were tried{message}",
            hint="look at design.parameters, design.initial and the ranges of the variables; more design.substeps "
            "take smaller steps",
        )
    return float(keep.mean())
