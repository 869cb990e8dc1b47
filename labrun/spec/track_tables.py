"""The tables of a closed-loop run: what is measured, what it should be, and what is set so that it becomes so."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from labrun.spec.condition import Value
from labrun.spec.table import Number, PluginTable, Table
from labrun.toml import Faults

LOOP_DEVICE = "loop"
"""Stands for the loops where a channel is named: ``loop.force_error``."""
LOOP_CHANNELS = ("reference", "feedback", "error", "drive", "requested")
"""What is recorded of every loop at each of its steps."""
TIMING_CHANNELS = ("latency_s", "late_s", "missed")
"""What is recorded of a step's time."""


def loop_channel(loop: str, quantity: str) -> str:
    """Return the name of a loop's channel: ``force_error``."""
    return f"{loop}_{quantity}"


def loop_channels(loops: list[str]) -> tuple[str, ...]:
    """Return the names of all channels that loops of these names record, timing last."""
    return (*(loop_channel(loop, name) for loop in loops for name in LOOP_CHANNELS), *TIMING_CHANNELS)


class LoopTable(Table):
    """One loop: a feedback is compared with a reference, and a controller sets one variable of the gait.

    `drives` is a name that the gait's expressions use; `range` bounds it, in its own unit, `slew_per_s` how fast it may
    change. It starts at `initial`: the value of the range that is nearest to zero, if not said.
    """

    drives: str
    range: tuple[Number, Number]
    slew_per_s: PositiveFloat | None = None
    initial: Number | None = None
    reference: PluginTable
    feedback: PluginTable
    controllers: dict[str, PluginTable] = Field(min_length=1)

    @model_validator(mode="after")
    def _range_is_one(self) -> "LoopTable":
        low, high = self.range
        with Faults() as faults:
            if not low < high:
                faults.add("range", f"[low, high], and {low:g} is not below {high:g}", of=("range",))
            elif self.initial is not None and not low <= self.initial <= high:
                faults.add(
                    "initial", f"{self.initial:g} is outside {low:g} ... {high:g}", of=("range", "initial")
                )
        return self

    @property
    def start(self) -> float:
        """Value of the variable before the first step."""
        low, high = self.range
        return float(min(max(0.0, low), high) if self.initial is None else self.initial)


class Track(Table):
    """Closed loops on a steered gait. Each condition says which controller is in charge.

    A trial of which more than `max_missed_share` of the steps came too late is rejected.
    """

    rate_hz: Annotated[float, Field(gt=0, le=1000)]
    conditions: list[dict[str, Value]] = Field(min_length=1)
    order: Literal["shuffled", "as-listed"] = "shuffled"
    max_missed_share: Annotated[float, Field(ge=0, le=1)] = 0.05
    loops: dict[str, LoopTable] = Field(min_length=1)
