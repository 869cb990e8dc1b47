"""The table [design]: geometry and gait searched in one, on a simulation that has the geometry as parameters."""

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, NonNegativeFloat, PositiveFloat

from labrun.spec.raw import check_expression, check_name, table, tables
from labrun.spec.search_tables import CmaEs, SearchVariable
from labrun.toml import Expression, Fault, KeyPath, Table

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


class WrittenExperiment(Table):
    """An experiment on the rig of the finished design: a file's text, with other values in one or more of its tables.

    `values` are expressions in the variables of the design, by the key they stand at in the file. `model_at` is the key
    that names a model there: `model`, or that of the design, with the parameters of the design takes its place.
    """

    template: str
    model_at: str | None = None
    model: str | None = None
    values: dict[str, Expression] = Field(default_factory=dict)


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
        return {name: one.tolerance for name, one in self.variables.items() if one.tolerance > 0}


def is_summary(name: str) -> bool:
    """Tell whether a constraint's name stands for a summary of a channel."""
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
            told = signal.removeprefix("command.")
            yield from check_name(told, path, joints, f'the gait has no joint "{told}"', kind="joints")
    yield from _check_expressions(design)


def _what_only_a_bench_has(data: Mapping[str, Any]) -> Iterator[Fault]:
    for key in ("over", "each", "reevaluate"):
        if table(data, "design").get(key):
            yield Fault(("design", key), "a design has none: its simulation is one, and repeats itself")
    for key in ("by_hand", "damage"):
        if key in data:
            yield Fault(
                (key,), "a design is simulated: there is nothing to be done by hand, or to be damaged"
            )
    for key in ("until", "carriage", "settle", "tare", "reference"):
        if key in table(data, "trial"):
            yield Fault(("trial", key), "a design is simulated: leave it out")


def _check_expressions(design: Mapping[str, Any]) -> Iterator[Fault]:
    variables = list(table(design, "variables"))
    for key in ("parameters", "initial"):
        for name, expression in table(design, key).items():
            yield from check_expression(expression, ("design", key, name), variables)
    for name, part in tables(design, "parts").items():
        for key in ("length_mm", "width_mm", "angle_deg"):
            yield from check_expression(part.get(key), ("design", "parts", name, key), variables)
    for name, written in tables(design, "writes").items():
        if "/" in name:
            yield Fault(("design", "writes", name), "the name of a file in this folder, without .toml")
        for key, expression in table(written, "values").items():
            yield from check_expression(expression, ("design", "writes", name, "values", key), variables)
