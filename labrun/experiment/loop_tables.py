"""The tables of closed loops, and the channels they record."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, PositiveFloat, Tag, model_validator

from labrun import registry
from labrun.errors import PluginError
from labrun.experiment.condition import Number, Value
from labrun.toml import PluginTable, Table, TableFaults

LOOP_DEVICE = "loop"
"""Stands for the loops where a channel is named: ``loop.force_error``."""
OF_FEEDBACK = ("reference", "feedback", "error")
OF_DRIVES = ("drive", "requested")
"""What is recorded of every loop at each of its steps."""
TIMING_CHANNELS = ("latency_s", "reaction_s", "late_s", "missed")
"""What is recorded of a step's time."""


def loop_channel(loop: str, quantity: str, part: str = "") -> str:
    """Return the name of a loop's channel: ``force_error``; of a loop of several, ``pose_error_qx``."""
    return f"{loop}_{quantity}_{part}" if part else f"{loop}_{quantity}"


@dataclass(frozen=True, slots=True)
class LoopShape:
    """What a loop has several of.

    Attributes
    ----------
    components
        Names of the feedback's numbers; one without a name where it is a single number.
    drives
        Names of the variables it sets, likewise.
    more
        What its controllers record besides: name -> unit.
    """

    components: tuple[str, ...]
    drives: tuple[str, ...]
    more: Mapping[str, str]

    def channels(self, loop: str) -> tuple[str, ...]:
        """Return the names of what the loop records, in the order in which it does."""
        return (
            *(loop_channel(loop, of, part) for of in OF_FEEDBACK for part in self.components),
            *(loop_channel(loop, of, part) for of in OF_DRIVES for part in self.drives),
            *(loop_channel(loop, name) for name in self.more),
        )


Part = tuple[object, Mapping[str, Any]]
"""A plugin's name as it stands in the file, and its keys."""


def shape_of(drives: Sequence[str], feedbacks: Sequence[Part], controllers: Iterable[Part]) -> LoopShape:
    """Return the shape of a loop from its tables; an unknown plugin counts as scalar."""
    more: dict[str, str] = {}
    for plugin, settings in controllers:
        more |= _asked("labrun.controllers", plugin, "records", settings) or {}
    labels = tuple(drives) if len(drives) > 1 else ("",)
    return LoopShape(_components(feedbacks), labels, more)


def _components(feedbacks: Sequence[Part]) -> tuple[str, ...]:
    if len(feedbacks) == 1:
        plugin, settings = feedbacks[0]
        return tuple(_asked("labrun.feedbacks", plugin, "components", settings) or ("",))
    names: list[str] = []
    for _, settings in feedbacks:
        channel = settings.get("channel")
        name = channel.rpartition(".")[2] if isinstance(channel, str) else ""
        names.append(name if name and name not in names else str(len(names) + 1))
    return tuple(names)


def _asked(group: str, plugin: object, what: str, settings: Mapping[str, Any]) -> Any:
    """Return what a plugin's class says of itself with these keys; None if it says nothing."""
    if not isinstance(plugin, str):
        return None
    try:
        return getattr(registry.load(group, plugin), what, lambda _: None)(settings)
    except (PluginError, TypeError, ValueError):  # refused with its place when the table is checked
        return None


def _form(value: object) -> str:
    """Tell one table from a list of them, so that an error is about the one that was meant."""
    return "several" if isinstance(value, list | tuple) else "one"


def _listed(value: object) -> object:
    return [value] if isinstance(value, str) else value


def _paired(value: object) -> object:
    """Return a list as the tuple that strict reading wants where the file has been read already."""
    return tuple(value) if isinstance(value, list) else value


OneOrSeveral = Annotated[
    Annotated[PluginTable, Tag("one")] | Annotated[list[PluginTable], Field(min_length=1), Tag("several")],
    Discriminator(_form),
]


class LoopTable(Table):
    """One loop: a feedback is compared with a reference, and a controller sets variables of the gait.

    `drives` are names that the gait's expressions use; `range` bounds each, in its own unit, `slew_per_s` how fast it
    may change. They start at `initial`: the value of the range that is nearest to zero, if not said. Reference and
    feedback are a table each, or a list of tables where there are several numbers to compare.
    """

    drives: Annotated[list[str], Field(min_length=1), BeforeValidator(_listed)]
    range: Annotated[tuple[Number, Number], BeforeValidator(_paired)]
    slew_per_s: PositiveFloat | None = None
    initial: Number | None = None
    reference: OneOrSeveral
    feedback: OneOrSeveral
    controllers: dict[str, PluginTable] = Field(min_length=1)

    @model_validator(mode="after")
    def _range_is_one(self) -> "LoopTable":
        low, high = self.range
        with TableFaults() as faults:
            if not low < high:
                faults.add("range", f"expected [low, high]; {low:g} is not below {high:g}", of=("range",))
            elif self.initial is not None and not low <= self.initial <= high:
                faults.add(
                    "initial", f"{self.initial:g} is outside {low:g} ... {high:g}", of=("range", "initial")
                )
        return self

    @property
    def start(self) -> float:
        """Value of each variable before the first step."""
        low, high = self.range
        return float(min(max(0.0, low), high) if self.initial is None else self.initial)

    @property
    def references(self) -> list[PluginTable]:
        """Its reference as a list."""
        return self.reference if isinstance(self.reference, list) else [self.reference]

    @property
    def feedbacks(self) -> list[PluginTable]:
        """Its feedback as a list."""
        return self.feedback if isinstance(self.feedback, list) else [self.feedback]

    @property
    def shape(self) -> LoopShape:
        """What it has several of."""
        return shape_of(
            self.drives,
            [(feedback.plugin, feedback.settings) for feedback in self.feedbacks],
            [(controller.plugin, controller.settings) for controller in self.controllers.values()],
        )


class Track(Table):
    """Closed loops on a steered gait. Each condition says which controller is in charge.

    A trial of which more than `max_missed_share` of the steps came too late is rejected.
    """

    rate_hz: Annotated[float, Field(gt=0, le=1000)]
    conditions: list[dict[str, Value]] = Field(min_length=1)
    order: Literal["shuffled", "as-listed"] = "shuffled"
    max_missed_share: Annotated[float, Field(ge=0, le=1)] = 0.05
    loops: dict[str, LoopTable] = Field(min_length=1)

    @property
    def steered(self) -> dict[str, LoopTable]:
        """Every variable that a loop sets, with the loop's table."""
        return {name: table for table in self.loops.values() for name in table.drives}

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of all that the loops record, timing last."""
        return (
            *(name for loop, table in self.loops.items() for name in table.shape.channels(loop)),
            *TIMING_CHANNELS,
        )
