"""The tables that say which trials there are: conditions one by one, sweeps, searches, designs."""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Discriminator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    Tag,
    field_validator,
    model_validator,
)

from labrun.experiment.condition import Bounds, Number, Value
from labrun.experiment.raw import asks_for_leaders, check_name, table, tables
from labrun.toml import Expression, ExpressionError, Fault, KeyPath, Table, TableFaults


class Range(Table):
    """An axis of a grid: from, to and step (both ends included)."""

    start: Number = Field(alias="from")
    stop: Number = Field(alias="to")
    step: PositiveFloat

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        with TableFaults() as faults:
            if self.stop < self.start:
                faults.add("to", f"{self.stop:g} is below from = {self.start:g}")
        return self


class Interval(Table):
    """An axis of a random or Sobol design, or a search variable: from, to."""

    start: Number = Field(alias="from")
    stop: Number = Field(alias="to")

    @model_validator(mode="after")
    def _ordered(self) -> "Interval":
        with TableFaults() as faults:
            if not self.start < self.stop:
                faults.add("to", f"{self.stop:g} is not above from = {self.start:g}")
        return self


Combine = Literal["sum", "mean", "worst"]
"""What becomes of the values of one candidate at several settings; the worst is the one farthest from the goal."""


class Over(Table):
    """Settings that every condition is measured at, all combinations of them, and how one value comes of theirs."""

    over: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default_factory=dict)
    combine: Combine = "mean"

    @model_validator(mode="after")
    def _something_to_combine(self) -> Self:
        with TableFaults() as faults:
            if self.combine != "mean" and not self.over:
                faults.add(
                    "combine", "nothing is there to combine; name the settings, over = { v = [0.1, 0.3] }"
                )
            for name, values in self.over.items():
                if len(set(values)) < len(values):
                    faults.add(
                        ("over", name), "names a value twice; trial.repeats says how often each is measured"
                    )
        return self


class LeadersOf(Table):
    """The best conditions of the latest run of another experiment, or of several."""

    leaders_of: str | Annotated[list[str], Field(min_length=1)]
    count: PositiveInt = 8
    names: list[str] = Field(default_factory=list)
    """Of the values of such a condition; found out when the file is loaded."""

    @property
    def experiments(self) -> list[str]:
        """The experiments whose leaders are taken."""
        return [self.leaders_of] if isinstance(self.leaders_of, str) else self.leaders_of


class TakenFrom(Table):
    """A run whose leaders became conditions."""

    experiment: str
    run: str


def _conditions_kind(conditions: object) -> str:
    if isinstance(conditions, Mapping):
        return "leaders" if asks_for_leaders(conditions) else "list"
    return "leaders" if isinstance(conditions, LeadersOf) else "list"


class RunTable(Over):
    """Conditions one by one, or the leaders of another run."""

    conditions: Annotated[
        Annotated[LeadersOf, Tag("leaders")]
        | Annotated[list[dict[str, Value]], Field(min_length=1), Tag("list")],
        Discriminator(_conditions_kind),
    ]
    order: Literal["shuffled", "as-listed"] = "shuffled"
    taken_from: list[TakenFrom] = Field(default_factory=list)


def _axis_kind(axis: object) -> str:
    """Select the form of an axis, so that errors refer to it."""
    if isinstance(axis, Range) or (isinstance(axis, Mapping) and "step" in axis):
        return "range"
    if isinstance(axis, Interval | Mapping):
        return "interval"
    return "list"


Axis = Annotated[
    Annotated[Range, Tag("range")]
    | Annotated[Interval, Tag("interval")]
    | Annotated[list[Value], Field(min_length=1), Tag("list")],
    Discriminator(_axis_kind),
]


class Sweep(Over):
    """Conditions from axes. Grid and list axes cross; random and Sobol designs take `samples` points of intervals."""

    design: Literal["grid", "random", "sobol"] = "grid"
    axes: dict[str, Axis] = Field(min_length=1)
    samples: PositiveInt | None = None
    where: list[str] = Field(default_factory=list)
    order: Literal["shuffled", "as-listed"] = "shuffled"

    @model_validator(mode="after")
    def _design_fits_axes(self) -> "Sweep":
        with TableFaults() as faults:
            for name, axis in self.axes.items():
                if isinstance(axis, Interval) and self.design == "grid":
                    faults.add(("axes", name), "an axis of a grid needs a step, or a list of values")
                if not isinstance(axis, Interval) and self.design != "grid":
                    faults.add(
                        ("axes", name), f"an axis of a {self.design} design is {{ from, to }} without step"
                    )
            if self.design != "grid" and self.samples is None:
                faults.add("design", f'"{self.design}" needs the number of points; add samples = 64')
            if self.design == "grid" and self.samples is not None:
                faults.add(
                    "samples",
                    'a grid has as many points as its axes; remove samples, or write design = "random" or "sobol"',
                )
        return self


class SearchVariable(Interval):
    """A search variable: its range, and where the search starts (the middle, if not said)."""

    initial: Number | None = None

    @model_validator(mode="after")
    def _initial_inside(self) -> "SearchVariable":
        with TableFaults() as faults:
            if self.initial is not None and not self.start <= self.initial <= self.stop:
                faults.add("initial", f"{self.initial:g} is outside {self.start:g} ... {self.stop:g}")
        return self


class Penalty(Table):
    """Cost of an infeasible candidate, which is never run.

    Worst feasible value + spread of the feasible values * (per_violation * number + per_size * size).
    """

    per_violation: PositiveFloat = 1.0
    per_size: PositiveFloat = 1.0


class StopRules(Table):
    """When a search ends, whichever comes first."""

    iterations: PositiveInt = 1000
    stagnation: PositiveInt | None = None
    step_size_below: PositiveFloat | None = None
    trials: PositiveInt | None = None


class Leaders(Table):
    """The confirmed best: number of leaders and of fresh repeats; the winner is confirmed by as many again.

    `beside` are conditions that were found elsewhere and are measured among the leaders.
    """

    count: PositiveInt = 5
    repeats: Annotated[int, Field(ge=2)] = 5
    beside: Annotated[
        Annotated[LeadersOf, Tag("leaders")] | Annotated[list[dict[str, Value]], Tag("list")],
        Discriminator(_conditions_kind),
    ] = Field(default_factory=list)
    taken_from: list[TakenFrom] = Field(default_factory=list)

    @property
    def guests(self) -> list[dict[str, Value]]:
        """The conditions that were found elsewhere; none as long as they are not known."""
        return self.beside if isinstance(self.beside, list) else []


class Guard(Table):
    """What a search keeps to while it looks around; the leaders are measured again without.

    `limits` by name: of a joint its angle in deg, of a channel ("wrench.force_x") its value in its unit.
    """

    limits: dict[str, Bounds] = Field(default_factory=dict)

    @property
    def channels(self) -> dict[str, list[Number]]:
        """Bounds of channels, held while a candidate is measured."""
        return {name: bounds for name, bounds in self.limits.items() if "." in name}

    @property
    def joints_deg(self) -> dict[str, list[Number]]:
        """Bounds of joints, beyond which no candidate is run."""
        return {name: bounds for name, bounds in self.limits.items() if "." not in name}


class CmaEs(Over):
    """Covariance matrix adaptation. `step_size` is a share of each variable's range."""

    variables: dict[str, SearchVariable] = Field(min_length=1)
    population: Annotated[int, Field(ge=4)] | None = None
    parents: PositiveInt | None = None
    step_size: PositiveFloat = 0.3
    where: list[str] = Field(default_factory=list)
    guard: Guard = Guard()
    penalty: Penalty = Penalty()
    each: dict[str, Annotated[list[Value], Field(min_length=1)]] = Field(default_factory=dict)
    """A search of its own for every combination of these."""
    restarts: Annotated[int, Field(ge=0)] = 0
    reevaluate: Annotated[int, Field(ge=0)] = 0
    """Leaders of a generation that are measured again in the next one."""
    stop: StopRules = StopRules()

    @property
    def population_size(self) -> int:
        """Candidates of a generation: `population`, or Hansen's default for this number of variables."""
        return self.population or 4 + int(3 * math.log(len(self.variables)))

    @model_validator(mode="after")
    def _sizes_fit(self) -> "CmaEs":
        population = self.population_size
        with TableFaults() as faults:
            if len(self.variables) < 2:
                faults.add(
                    "variables",
                    'CMA-ES needs at least two variables; search over one with kind = "sweep"',
                    of=("variables",),
                )
            if self.parents is not None and 2 * self.parents > population:
                faults.add(
                    "parents",
                    f"more than half of the population of {population}; select at most {population // 2} parents",
                    of=("parents", "population", "variables"),
                )
            if self.reevaluate > population - 2:
                faults.add(
                    "reevaluate",
                    f"leaves no room for new candidates in a population of {population}; measure fewer leaders again, "
                    "for example 3",
                    of=("reevaluate", "population", "variables"),
                )
        return self


SIMULATION = "simulation"
"""Stands for the simulated trial where a channel is named: ``simulation.x``."""
SUMMARIES = ("max", "min", "mean", "rms", "final", "peak")
"""What a constraint may say of a channel, before its name: ``max_hinge_1``."""
_SUMMARY = re.compile(rf"^(?:{'|'.join(SUMMARIES)})_\w+$")


class DesignVariable(SearchVariable):
    """A search variable of a design; with `tolerance` a dimension, which is built to so much more or less."""

    tolerance: NonNegativeFloat = 0.0


class DrawnPart(Table):
    """A part as the drawing shows it: a rectangle about a line from `from_mm` on, turned by `angle_deg`.

    `mirrored` draws it on the other side of the line y = 0 as well.
    """

    from_mm: Annotated[list[Expression], Field(min_length=2, max_length=2)]
    length_mm: Expression
    width_mm: Expression
    angle_deg: Expression = Expression.of(0.0)
    mirrored: bool = False


BRACES = re.compile(r"\{([^{}]*)\}")
"""An expression in a text of `WrittenExperiment`."""


class WrittenExperiment(Table):
    """An experiment on the rig of the finished design: a file's text, with other values in one or more of its tables.

    `values` are expressions in the variables of the design, by the key they stand at in the file; an element of a list
    is known by its place, from 0. `texts` are words with such expressions in braces. `model_at` is the key that names a
    model there: `model`, or that of the design, with the parameters of the design takes its place.
    """

    template: str
    model_at: str | None = None
    model: str | None = None
    values: dict[str, Expression] = Field(default_factory=dict)
    texts: dict[str, str] = Field(default_factory=dict)

    @field_validator("texts")
    @classmethod
    def _has_expressions(cls, texts: dict[str, str]) -> dict[str, str]:
        try:
            for text in texts.values():
                for expression in BRACES.findall(text):
                    Expression.of(expression)
        except ExpressionError as error:
            raise ValueError(str(error)) from error
        return texts


class Design(CmaEs):
    """A search by CMA-ES whose trial is a simulation of `model`.

    `parameters` of the model, states it begins in (`initial`), and `channels` in addition to its outputs, are
    expressions in the variables, channels in the outputs as well. A constraint of `where` that uses variables only is
    judged before the simulation; the others name summaries of channels, such as ``max_hinge_1``.
    """

    variables: dict[str, DesignVariable] = Field(min_length=1)  # type: ignore[assignment]
    model: str
    parameters: dict[str, Expression] = Field(default_factory=dict)
    signals: dict[str, str] = Field(default_factory=dict)
    initial: dict[str, Expression] = Field(default_factory=dict)
    channels: dict[str, Expression] = Field(default_factory=dict)
    rate_hz: PositiveFloat = 200.0
    substeps: Annotated[int, Field(ge=1, le=256)] = 2
    parts: dict[str, DrawnPart] = Field(default_factory=dict)
    writes: dict[str, WrittenExperiment] = Field(default_factory=dict)

    @property
    def dimensions(self) -> dict[str, float]:
        """Variables that are built, with their tolerance."""
        return {
            name: variable.tolerance for name, variable in self.variables.items() if variable.tolerance > 0
        }


def is_summary(name: str) -> bool:
    """Tell whether a name in a constraint is a summary of a channel."""
    return _SUMMARY.match(name) is not None


def check_design(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield what does not fit between the table [design] and the rest, as far as shows without the model."""
    if data.get("kind") != "design":
        return
    yield from _what_only_a_bench_has(data)
    design = table(data, "design")
    joints = table(data, "gait", "joints")
    for name, signal in table(design, "signals").items():
        path: KeyPath = ("design", "signals", name)
        if isinstance(signal, str):
            channel = signal.removeprefix("command.")
            yield from check_name(channel, path, joints, f'the gait has no joint "{channel}"', kind="joints")
    for name in tables(design, "writes"):
        if "/" in name:
            yield Fault(
                ("design", "writes", name), "expected the name of a file in this folder, without .toml"
            )


def _what_only_a_bench_has(data: Mapping[str, Any]) -> Iterator[Fault]:
    for key in ("over", "each", "reevaluate"):
        if table(data, "design").get(key):
            yield Fault(
                ("design", key),
                "a design is simulated, and its simulation repeats itself exactly; remove this key",
            )
    for key in ("by_hand", "damage"):
        if key in data:
            yield Fault(
                (key,),
                "a design is simulated: nothing is done by hand, and nothing is damaged; remove this table",
            )
    for key in ("until", "carriage", "settle", "tare", "reference"):
        if key in table(data, "trial"):
            yield Fault(("trial", key), "a design is simulated and has no such key; remove it")
