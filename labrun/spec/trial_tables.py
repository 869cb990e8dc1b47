"""The tables of a trial: how long, how often, and what makes it trustworthy."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from labrun.spec.condition import Bounds, Number, Value
from labrun.spec.until import Until
from labrun.toml import Expression, Table, TableFaults


class RepeatRule(Table):
    """How often a condition is measured.

    At least `min` times, then until every standard error is small enough, at most `max` times.
    """

    min: PositiveInt
    max: PositiveInt
    standard_error: dict[str, PositiveFloat] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _table_or_number(cls, data: Any) -> Any:
        if not isinstance(data, Mapping | RepeatRule):
            raise ValueError("a whole number, or a table { min = 3, max = 10 }")
        return data

    @field_validator("standard_error", mode="before")
    @classmethod
    def _bound_of_each(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            bound = f"{data:g}" if isinstance(data, float | int) else "..."
            raise ValueError(f"a table with a bound for each objective by its name: {{ thrust = {bound} }}")
        return data

    @model_validator(mode="after")
    def _ordered(self) -> "RepeatRule":
        with TableFaults() as faults:
            if self.max < self.min:
                faults.add("max", f"{self.max} is below min = {self.min}")
        return self


class Settle(Table):
    """When the bench counts as at rest.

    `below` bounds spread and drift of the channel, in its SI unit; without it, the bench's own quiet baseline,
    measured before the first trial, is the bound (times `factor`).
    """

    until: Literal["quiet", "time"] = "quiet"
    channel: str | None = None
    below: PositiveFloat | None = None
    factor: PositiveFloat = 1.5
    hold_s: PositiveFloat = 2.0
    timeout_s: PositiveFloat = 60.0
    on_timeout: Literal["go-on", "reject", "stop"] = "go-on"


class Tare(Table):
    """Zero of the force channels, averaged over a quiet moment before each recording. Raw data stay raw."""

    duration_s: PositiveFloat = 1.0
    devices: list[str] | None = None


class Outliers(Table):
    """The outlier rule, declared beforehand. A rejected trial is kept, with its reason."""

    rule: Literal["none", "mad"] = "none"
    objective: str | None = None
    threshold: PositiveFloat = 3.5
    minimum: Annotated[int, Field(ge=3)] = 3


class ReferenceTable(Table):
    """A condition measured every so many trials, so that drift of the bench is seen."""

    every: PositiveInt
    condition: dict[str, Value] = Field(min_length=1)


class CarriageMove(Table):
    """The carriage's part in a trial: it goes to `from_m`, and travels at `speed_m_s` while samples are taken.

    What counts is the travel at that speed: the ramps at `acceleration_m_s2`, and `margin_s` after the first of them,
    are left out. Without `acceleration_m_s2` the carriage takes its own.
    """

    device: str
    speed_m_s: Expression
    from_m: Number = 0.0
    to_m: Number
    return_speed_m_s: PositiveFloat = 0.1
    acceleration_m_s2: Annotated[float, Field(gt=0, le=3)] | None = None
    margin_s: Annotated[float, Field(ge=0)] = 0.1
    """The order takes a moment to become motion, so that the ramp ends later than its length says."""


class CyclesOf(Table):
    """What counts of a recording: whole cycles of one joint, whatever the others do."""

    cycles_of: str


Averaging = Literal["beats"] | CyclesOf


class TrialTable(Table):
    """One trial.

    Length: `cycles` of the gait (or "fit": as many as the carriage's travel allows), `duration_s` (or "fit": as long as
    the carriage is at its speed), or `until` its numbers say so.
    """

    cycles: PositiveInt | Literal["fit"] | None = None
    duration_s: PositiveFloat | Literal["fit"] | None = None
    until: Until | None = None
    discard_cycles: Annotated[int, Field(ge=0)] = 0
    average: Averaging | None = None
    """What objectives look at where joints share no cycle; what it cuts widens the intervals of means."""
    repeats: RepeatRule = RepeatRule(min=1, max=1)
    settle: Settle | None = None
    tare: Tare | None = None
    outliers: Outliers = Outliers()
    reference: ReferenceTable | None = None
    carriage: CarriageMove | None = None
    within: dict[str, Bounds] = Field(default_factory=dict)
    """Channels that end a trial, rejected, when they leave their bounds."""
    safe_pose_deg: dict[str, float] = Field(default_factory=dict)
    move_speed_deg_s: PositiveFloat = 60.0
    on_fault: Literal["stop", "retry-trial", "skip"] = "stop"
    retries: Annotated[int, Field(ge=0)] = 1
    max_lost_share: Annotated[float, Field(ge=0, le=1)] = 0.02
    """A recording that lost a greater share of a device's samples is rejected."""

    @field_validator("average", mode="before")
    @classmethod
    def _beats_or_joint(cls, data: Any) -> Any:
        if data is None or data == "beats" or isinstance(data, Mapping | CyclesOf):
            return data
        raise ValueError('"beats", or a joint whose whole cycles count, { cycles_of = "tail" }')

    @model_validator(mode="before")
    @classmethod
    def _short_repeats(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("repeats"), int):
            return {**data, "repeats": {"min": data["repeats"], "max": data["repeats"]}}
        return data

    @model_validator(mode="after")
    def _one_length(self) -> "TrialTable":
        with TableFaults() as faults:
            length = ("cycles", "duration_s", "until")
            given = [name for name in length if getattr(self, name) is not None]
            if not given:
                faults.add(None, "has no length: give cycles, duration_s or until", of=length)
            for name in given[1:]:
                faults.add(
                    name,
                    f"the trial has two lengths, with {given[0]}: give cycles, duration_s or until",
                    of=length,
                )
            if self.until is not None and self.discard_cycles:
                faults.add("discard_cycles", "with until every cycle counts: until.when can leave some out")
            if isinstance(self.cycles, int) and self.discard_cycles >= self.cycles:
                faults.add(
                    "discard_cycles",
                    f"{self.discard_cycles} leaves nothing of {self.cycles} cycles",
                    of=("cycles", "discard_cycles"),
                )
            if self.average is not None and self.duration_s is None:
                faults.add(
                    "average",
                    "is for joints that share no cycle, and so goes with duration_s; cycles count as they are",
                    of=("average", "cycles"),
                )
            for name in ("cycles", "duration_s"):
                if getattr(self, name) == "fit" and self.carriage is None:
                    faults.add(
                        name, '"fit" needs a carriage, whose travel sets the length', of=(name, "carriage")
                    )
        return self
