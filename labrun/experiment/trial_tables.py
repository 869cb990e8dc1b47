"""The tables of a trial: how long, or until what, how often, and what makes it trustworthy."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from labrun.experiment.condition import Bounds, Number, Value
from labrun.experiment.raw import check_name, table
from labrun.toml import Expression, ExpressionError, Fault, KeyPath, Table, TableFaults, fault_of

CYCLES = "cycles"
"""Objective and signals that tell of the cycles of such a trial."""
CYCLE = "cycle"
"""Stands for the number of the cycle in a condition, from 1."""
_SUMMARY = re.compile(r"\b(median|mean|min|max)\s*\(\s*(?:([A-Za-z_]\w*)\s*,\s*)?(first|last)\s+(\d+)\s*\)")
_COMPUTE: dict[str, Callable[[Sequence[float]], Any]] = {
    "median": np.median,
    "mean": np.mean,
    "min": np.min,
    "max": np.max,
}


class Until(Table):
    """A trial that goes on until its numbers say so, judged once a cycle, for `max_cycles` at most.

    Every cycle's objectives are kept, and the samples of one cycle in `keep_every`. With `judge_every` only one cycle
    in so many is measured, once the first `keep_every` are over; those between are moved, and count as alike.
    """

    when: str
    max_cycles: PositiveInt
    keep_every: PositiveInt = 100
    judge_every: PositiveInt = 1

    @model_validator(mode="after")
    def _keeps_what_it_judges(self) -> Self:
        with TableFaults() as faults:
            if self.judge_every > self.keep_every:
                message = (
                    f"is above keep_every = {self.keep_every}: the motion goes out in stretches of keep_every"
                )
                faults.add("judge_every", message, of=("judge_every", "keep_every"))
        return self


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
            raise ValueError("expected a whole number, or a table { min = 3, max = 10 }")
        return data

    @field_validator("standard_error", mode="before")
    @classmethod
    def _bound_of_each(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            bound = f"{data:g}" if isinstance(data, float | int) else "..."
            raise ValueError(f"expected a table with a bound for each objective: {{ thrust = {bound} }}")
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


class Follow(Table):
    """How closely a measured joint follows its command.

    A joint that its own actuator measures fails the trial when it is more than `within_deg` from its command for more
    than `for_s`, added up over any four times `for_s`. The command of any moment of the last `lag_s` counts.
    """

    within_deg: PositiveFloat = 20.0
    for_s: PositiveFloat = 0.5
    lag_s: Annotated[float, Field(ge=0)] = 0.1


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
    follow: Follow = Follow()
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
        raise ValueError('expected "beats", or a joint whose whole cycles count, { cycles_of = "tail" }')

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
                    f"the trial has another length already, {given[0]}; give one of cycles, duration_s and until",
                    of=length,
                )
            if self.until is not None and self.discard_cycles:
                faults.add(
                    "discard_cycles",
                    "a trial with until counts every cycle; leave cycles out in until.when, or remove this key",
                )
            if isinstance(self.cycles, int) and self.discard_cycles >= self.cycles:
                faults.add(
                    "discard_cycles",
                    f"no cycle is left: the trial has {self.cycles}; discard fewer, or make it longer",
                    of=("cycles", "discard_cycles"),
                )
            if self.average is not None and self.duration_s is None:
                faults.add(
                    "average",
                    "averages over joints that share no cycle and needs duration_s; remove it where whole cycles count",
                    of=("average", "cycles"),
                )
            for name in ("cycles", "duration_s"):
                if getattr(self, name) == "fit" and self.carriage is None:
                    faults.add(
                        name, '"fit" needs a carriage, whose travel sets the length', of=(name, "carriage")
                    )
        return self


@dataclass(frozen=True, slots=True)
class _Summary:
    """What ``median(first 100)`` stands for."""

    function: str
    objective: str
    end: str
    count: int

    def of(self, values: Sequence[float]) -> float | None:
        """Return it of an objective's values so far; None while there are too few."""
        if len(values) < self.count:
            return None
        chosen = values[: self.count] if self.end == "first" else values[len(values) - self.count :]
        return float(_COMPUTE[self.function](chosen))


@dataclass(frozen=True, slots=True)
class Criterion:
    """A condition on the numbers of a trial's cycles.

    ``peak < 0.2 * median(first 100)``: an objective's name is its value in the latest cycle; `median`, `mean`, `min` or
    `max` of the ``first`` or ``last`` so many cycles summarise the one objective that the condition names, or the one
    that is written before the comma: ``mean(work, last 10)``. ``cycle`` is the number of cycles. Where a summary still
    lacks cycles, nothing is judged.
    """

    text: str
    expression: Expression
    summaries: Mapping[str, _Summary]

    @classmethod
    def of(cls, text: str, objectives: Sequence[str]) -> "Criterion":
        """Return the criterion of a text.

        Raises
        ------
        ExpressionError
            It is not of the language, compares nothing, or a summary could be of several objectives.
        """
        named = [name for name in objectives if re.search(rf"\b{re.escape(name)}\b", text)] or list(
            objectives
        )
        summaries: dict[str, _Summary] = {}

        def taken(match: re.Match[str]) -> str:
            function, objective, end, count = match.groups()
            if objective is None and len(named) != 1:
                example = f"{function}({(named or ['NAME'])[0]}, {end} {count})"
                raise ExpressionError(
                    text, f"{match[0]} does not name its objective; write {example}", match.start()
                )
            if int(count) == 0:
                raise ExpressionError(
                    text, f"{match[0]} covers no cycle; write a number of at least 1", match.start()
                )
            summary = _Summary(function, objective or named[0], end, int(count))
            name = f"{function}_{end}_{count}_of_{summary.objective}"
            summaries[name] = summary
            return name

        plain = _SUMMARY.sub(taken, text)
        if half := re.search(r"\bmedian\b|\bmean\b|\b(first|last)\s+\d", plain):
            hint = f"{text[half.start() :][:20]!r} is not a summary of cycles; write for example median(first 100)"
            raise ExpressionError(text, hint, half.start())
        expression = Expression.of(plain)
        if not expression.is_comparison:
            raise ExpressionError(
                text, 'is not a comparison; write for example "peak < 0.2 * median(first 100)"'
            )
        return cls(text, expression, summaries)

    @property
    def names(self) -> list[str]:
        """The objectives that it is about, and perhaps ``cycle``."""
        plain = [name for name in self.expression.names if name not in self.summaries]
        return list(dict.fromkeys([*plain, *(summary.objective for summary in self.summaries.values())]))

    def holds(self, history: Mapping[str, Sequence[float]]) -> bool:
        """Tell whether it holds after the latest of the cycles; `history` has an objective's value of each."""
        values: dict[str, float] = {name: cycles[-1] for name, cycles in history.items()}
        values[CYCLE] = float(max(len(cycles) for cycles in history.values()))
        for name, term in self.summaries.items():
            summary = term.of(history[term.objective])
            if summary is None:
                return False
            values[name] = summary
        return bool(self.expression(values))


def check_until(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield what does not fit between trial.until and the rest of the file."""
    trial, until = table(data, "trial"), table(data, "trial", "until")
    if not until:
        return
    objectives = [name for name, objective in table(data, "objectives").items() if name != CYCLES]
    path: KeyPath = ("trial", "until", "when")
    when = until.get("when")
    if isinstance(when, str):
        try:
            criterion = Criterion.of(when, objectives)
        except ExpressionError as error:
            yield Fault(path, fault_of(error), at_value=True)
        else:
            for name in criterion.names:
                known = [*objectives, CYCLE]
                yield from check_name(name, path, known, f'no objective "{name}"', kind="objectives")
            most, first = (
                until.get("max_cycles"),
                max((summary.count for summary in criterion.summaries.values()), default=0),
            )
            if isinstance(most, int) and 0 < most < first:
                complaint = (
                    f"trial.until.when needs {first} cycles and would never be judged; allow at least as many"
                )
                yield Fault(("trial", "until", "max_cycles"), complaint, at_value=True)
    if CYCLE in objectives:
        yield Fault(
            ("objectives", CYCLE), "this name is reserved for the number of the cycle; choose another name"
        )
    own = table(data, "objectives", CYCLES)
    if own and own.get("plugin") != CYCLES:
        yield Fault(
            ("objectives", CYCLES), "this name is reserved for the number of cycles; choose another name"
        )
    if CYCLES in table(data, "rig", "devices"):
        yield Fault(
            ("rig", "devices", CYCLES),
            "this name is reserved for the numbers of the cycles; choose another name",
        )
    if "carriage" in trial:
        yield Fault(
            ("trial", "carriage"),
            "a trial with until has no end that a travel could have; remove this table, or trial.until",
        )
    if trial.get("on_fault", "stop") != "stop":
        text = 'a trial with until needs "stop", so that labrun resume continues with the same cycles'
        yield Fault(("trial", "on_fault"), text, at_value=True)
    if data.get("kind") == "track":
        yield Fault(("trial", "until"), "a closed loop needs cycles or duration_s in place of until")
