"""A learned model as controller, optionally trained while the loop runs."""

from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt

from labrun.control.learning import InlineLearner, Learner, LearnerTask, ProcessLearner
from labrun.control.protocol import FindFile, LoopContext, Numbers, VectorStep
from labrun.errors import SpecError
from labrun.learned import LearnedModel, Network, from_table, load_inverse, read_learned, to_table
from labrun.toml import Table, checked, suggest

KEPT_SAMPLES = 64
"""Newest samples of the measured drives, between which the moment of a feedback is found."""


class LearnTable(Table):
    """Keys of `learn`: how weights follow the bench while the loop runs.

    Attributes
    ----------
    measured
        Which channel measures which drive: ``{ theta_1 = "servos.servo_1_angle" }``, rad channels for drives in deg.
    every
        Every so many steps is one sample.
    ridge
        How hard weights are held at those of the file, relative to the inputs' variance, for each sample.
    simulated_s
        How long a training takes in simulated time, where nothing may depend on the computer.
    """

    measured: Annotated[dict[str, str], Field(min_length=1)]
    every: PositiveInt = 1
    ridge: Annotated[float, Field(ge=0)] = 1e-4
    simulated_s: PositiveFloat = 0.02


class NetworkSettings(Table):
    """Keys of `network`.

    Attributes
    ----------
    model
        TOML file of a learned model, as ``labrun fit NAME --model mlp`` writes it, with its npz beside it.
    learn
        Train it further while the loop runs, see `LearnTable`; without it the weights stay.
    history_s
        Samples count for so long in the learning; 0: for ever. May be an expression in names of the condition.
    """

    model: str | dict[str, Any]
    learn: LearnTable | None = None
    history_s: Annotated[float, Field(ge=0)] = 0.0


class NetworkController:
    """Control by a network, added to an analytic inverse if it was fitted to correct one.

    The reference's components are the network's inputs, by name; the loop's drives its outputs. `settings`: see
    `NetworkSettings`. `context`: of the loop, whose names, units and bench must be those of the model. Raises
    SpecError: a model of another bench, inputs that the loop does not have, drives it does not set, or other units.
    """

    Settings: ClassVar[type[Table]] = NetworkSettings
    several: ClassVar[bool] = True
    channel_settings: ClassVar[tuple[str, ...]] = ("learn.measured",)

    def __init__(self, settings: Mapping[str, Any], context: LoopContext) -> None:
        keys = checked(NetworkSettings, settings)
        if isinstance(keys.model, str):
            raise SpecError(
                f'the model "{keys.model}" is a file, and was not read',
                hint="load the experiment from its file",
            )
        model = from_table(keys.model)
        _require_fit(model, context)
        self.order = [context.components.index(name) for name in model.inputs]
        self.places = [list(model.outputs).index(name) for name in context.drives]
        self.nominal = load_inverse(model.added_to) if model.added_to else None
        self.network = model.network
        self._use(model.network)
        self.learning: _Learning | None = None
        self.channels: tuple[str, ...] = ()
        if keys.learn is not None:
            self.learning = _Learning(keys.learn, keys.history_s, model, self.order, context)
            self.channels = self.learning.channels

    @staticmethod
    def embed(settings: Mapping[str, Any], find: FindFile) -> dict[str, Any]:
        """Return the settings with the model that their file holds."""
        model = settings.get("model")
        if not isinstance(model, str):
            return dict(settings)
        return {**settings, "model": to_table(read_learned(find(model)))}

    @staticmethod
    def records(settings: Mapping[str, Any]) -> dict[str, str]:
        """Return the channels of its learning: none if it does not learn."""
        return dict(RECORDED) if settings.get("learn") is not None else {}

    def begin(self) -> None:
        """Start the learning."""
        if self.learning is not None:
            self.learning.learner.begin()

    def ready(self) -> bool:
        """Tell whether the learner is ready."""
        return self.learning is None or self.learning.learner.ready()

    def end(self) -> None:
        """End it."""
        if self.learning is not None:
            self.learning.learner.end()

    def remarks(self) -> list[str]:
        """Return remarks on the learner, if it failed."""
        return [] if self.learning is None else list(self.learning.learner.remarks)

    def update(self, step: VectorStep) -> Numbers:
        """Return the output of the network for the reference."""
        if self.learning is not None:
            newest = self.learning.take(step)
            if newest is not None:
                self._use(newest)
        values = [step.reference[index] for index in self.order]
        outputs = self._map(values)
        if self.nominal is not None:
            nominal = self.nominal(step.reference)
            return tuple([nominal[i] + outputs[location] for i, location in enumerate(self.places)])
        return tuple([outputs[location] for location in self.places])

    def applied(self, drives: Numbers) -> None:
        """Take no note."""

    def recorded(self) -> Mapping[str, float]:
        """Return the values of the channels of its learning."""
        return {} if self.learning is None else self.learning.recorded()

    def _use(self, network: Network) -> None:
        self._map = _quick(network) if network.activation == "identity" else network.point


RECORDED = {"weights_age_s": "s", "weights_lag_s": "s", "training_s": "s", "trainings": "1", "learning": "1"}
"""Since when the weights in force have been so; how old their newest sample was when they came; how long they took; how
many have come; whether the learner lives."""


class _Learning:
    """What a controller hands to its learner, and takes from it."""

    def __init__(
        self, table: LearnTable, history_s: float, model: LearnedModel, order: list[int], context: LoopContext
    ) -> None:
        strange = set(table.measured) ^ set(model.outputs)
        if strange:
            raise SpecError(
                f"learn.measured must say which channel measures each of {', '.join(model.outputs)}",
                hint=f"look at {', '.join(sorted(strange))}",
            )
        self.channels = tuple(table.measured[name] for name in model.outputs)
        self.factors = [np.degrees(1.0) if model.outputs[name] == "deg" else 1.0 for name in model.outputs]
        self._order, self.every = order, table.every
        self._nominal = load_inverse(model.added_to) if model.added_to else None
        self._steps = 0
        self._recent: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=KEPT_SAMPLES)
        self.ridge, self.history_s = table.ridge, history_s
        self.window = max(8, round(history_s / (context.period_s * table.every))) if history_s else None
        task = LearnerTask(model.network, self.window, table.ridge)
        self.learner: Learner = (
            InlineLearner(task, table.simulated_s) if context.simulated else ProcessLearner(task)
        )
        self._since_s = 0.0
        self._now_s = 0.0

    def take(self, step: VectorStep) -> Network | None:
        """Pass a sample to the learner, and return new weights if any."""
        self._now_s = step.time_s
        self._recent.append(
            (
                step.channels_s[self.channels[0]],
                tuple([f * step.channels[c] for f, c in zip(self.factors, self.channels, strict=True)]),
            )
        )
        if self._steps % self.every == 0 and self._recent[0][0] <= step.feedback_s:
            drives = _at(self._recent, step.feedback_s)
            if self._nominal is not None:
                drives = [a - b for a, b in zip(drives, self._nominal(step.feedback), strict=True)]
            self.learner.give(step.feedback_s, [step.feedback[index] for index in self._order], drives)
        self._steps += 1
        newest = self.learner.newest(step.time_s)
        if newest is not None:
            self._since_s = step.time_s
        return newest

    def recorded(self) -> Mapping[str, float]:
        """Return the values of `RECORDED`."""
        learner = self.learner
        return {
            "weights_age_s": self._now_s - self._since_s,
            "weights_lag_s": learner.lag_s,
            "training_s": learner.training_s,
            "trainings": float(learner.trainings),
            "learning": float(learner.alive),
        }


def _at(recent: deque[tuple[float, tuple[float, ...]]], time_s: float) -> list[float]:
    """Return the drives at a time, straight between two samples; the newest ones after the last."""
    after_s, after = recent[-1]
    if time_s >= after_s:
        return list(after)
    for before_s, before in reversed(recent):
        if before_s <= time_s:
            share = (time_s - before_s) / (after_s - before_s) if after_s > before_s else 0.0
            return [a + share * (b - a) for a, b in zip(before, after, strict=True)]
        after_s, after = before_s, before
    return list(after)


@np.errstate(over="ignore", invalid="ignore")
def _quick(network: Network) -> Any:
    """Return an affine network as sums of plain numbers: for four inputs far quicker than arrays."""
    collapsed = network.collapsed()
    (weight,), (bias,) = collapsed.weights, collapsed.biases
    slope = weight.T * network.outputs.scale[:, None] / network.inputs.scale
    level = network.outputs.back(bias) - slope @ network.inputs.mean
    rows = [(float(c), *map(float, row)) for c, row in zip(level, slope, strict=True)]

    def values(inputs: list[float]) -> tuple[float, ...]:
        return tuple([row[0] + sum([a * x for a, x in zip(row[1:], inputs, strict=True)]) for row in rows])

    return values


def _require_fit(model: LearnedModel, context: LoopContext) -> None:
    """Raise SpecError unless a model is of this bench and this loop."""
    if model.rig and context.rig and model.rig != context.rig:
        raise SpecError(
            f"these weights were learned on another rig: {model.rig}, and this is {context.rig}",
            hint="fit a model to a run of this rig: labrun fit NAME --model mlp",
        )
    missing = [name for name in model.inputs if name not in context.components]
    if missing:
        have = [name for name in context.components if name]
        near = suggest(missing[0], have, kind="its numbers") if have else "its feedback is a single number"
        raise SpecError(
            f"the loop has no {', '.join(missing)}, which the weights need: {', '.join(model.inputs)}",
            hint=f"choose a feedback with these numbers; {near}",
        )
    if set(model.outputs) != set(context.drives):
        raise SpecError(
            f"the weights give {', '.join(model.outputs)}, and the loop drives {', '.join(context.drives)}",
            hint="drive the names that the model was fitted with, or fit it with these",
        )
    for name, unit in model.outputs.items():
        if context.drives[name] and unit != context.drives[name]:
            raise SpecError(
                f"the weights give {name} in {unit}, and the loop sets it in {context.drives[name]}",
                hint=f'fit it with unit = "{context.drives[name]}": these weights have another scaling',
            )
