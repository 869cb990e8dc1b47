"""A finished design as others take it: its drawing, a table of its dimensions, its model, experiments on its rig."""

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass

import tomli_w

from labrun.design.simulator import Simulator
from labrun.errors import RequestError
from labrun.experiment import BRACES, Condition, Design, WrittenExperiment
from labrun.models import corrected_model_text, load_model
from labrun.toml import Expression, KeyPath, locate, replaced, suggest

MADE = "# Written by labrun design"
"""How a file begins that a design has written, and a later one may replace."""

_KEEP = "# A later design replaces this file. Take these two lines away to keep it."


def dimensions_csv(design: Design, values: Condition, units: Mapping[str, str]) -> str:
    """Return the variables of a design as a table: name, value, tolerance, unit, range; those to be built first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "value", "tolerance", "unit", "from", "to"))
    ordered = sorted(design.variables, key=lambda name: design.variables[name].tolerance == 0)
    for name in ordered:
        variable = design.variables[name]
        tolerance = variable.tolerance or ""
        writer.writerow(
            (
                name,
                f"{float(values[name]):.6g}",
                tolerance,
                units.get(name, ""),
                variable.start,
                variable.stop,
            )
        )
    return text.getvalue()


def model_text(simulator: Simulator, values: Condition, *, run: str, model: str | None = None) -> str:
    """Return the model of a finished design, or another of its parameters, as a file to be named wherever a model is.

    Raises
    ------
    ModelError
        The other model does not have the parameters of the design.
    """
    return corrected_model_text(
        simulator.loaded if model is None else load_model(model),
        simulator.model if model is None else model,
        simulator.parameters(values),
        remarks=f"the design found by {run}",
        heading=f"{MADE[2:]},",
    )


def written_experiment(
    written: WrittenExperiment,
    template: str,
    key: str,
    values: Condition,
    *,
    title: str,
    run: str,
    model: str,
) -> str:
    """Return an experiment on the rig of a finished design.

    Parameters
    ----------
    written
        Which values stand where.
    template
        The text of the experiment that it is like.
    key
        Where in the design's file `written` stands, for messages.
    title, run
        Of the design, for the comment on top.
    model
        The file of the design's model.

    Raises
    ------
    RequestError
        The template has no such key.
    """
    known = {".".join(map(str, path)): path for path in locate(template).spans}
    given: dict[str, float | str] = {name: float(value(values)) for name, value in written.values.items()}
    given |= {name: _filled(text, values) for name, text in written.texts.items()}
    if written.model_at is not None:
        given[written.model_at] = model
    places: dict[KeyPath, str] = {}
    for name, value in given.items():
        if name not in known:
            raise RequestError(
                f"{key}: {written.template} has no key {name}", hint=suggest(name, list(known))
            )
        places[known[name]] = _as_toml(value)
    about = f"{MADE} ({run}): {title.splitlines()[0]}"
    text = replaced(template, places)
    while text.startswith((MADE, _KEEP)):  # the template is what a design wrote before
        text = text.partition("\n")[2]
    return "\n".join([about, _KEEP, text])


def _filled(text: str, values: Condition) -> str:
    """Return a text with the numbers of the design in the place of expressions in braces."""
    return BRACES.sub(lambda match: f"{float(Expression.of(match[1])(values)):.6g}", text)


def _as_toml(value: float | str) -> str:
    return tomli_w.dumps({"a": value}).removeprefix("a = ").strip()


@dataclass(frozen=True, slots=True)
class DrawnPart:
    """One part: a rectangle about a line from (`x_mm`, `y_mm`) on, turned by `angle_rad` from the x axis."""

    name: str
    x_mm: float
    y_mm: float
    length_mm: float
    width_mm: float
    angle_rad: float

    @property
    def end_mm(self) -> tuple[float, float]:
        """Where its line ends."""
        return (
            self.x_mm + self.length_mm * math.cos(self.angle_rad),
            self.y_mm + self.length_mm * math.sin(self.angle_rad),
        )

    def corners_mm(self) -> list[tuple[float, float]]:
        """Return the four corners, in order."""
        aside_x = -0.5 * self.width_mm * math.sin(self.angle_rad)
        aside_y = 0.5 * self.width_mm * math.cos(self.angle_rad)
        end_x, end_y = self.end_mm
        return [
            (self.x_mm + aside_x, self.y_mm + aside_y),
            (end_x + aside_x, end_y + aside_y),
            (end_x - aside_x, end_y - aside_y),
            (self.x_mm - aside_x, self.y_mm - aside_y),
        ]


@dataclass(frozen=True, slots=True)
class Drawing:
    """All parts, with the dimensions that are built to a tolerance.

    Attributes
    ----------
    parts
        Mirrored ones follow theirs.
    dimensions : name -> (mm or whatever the variable is in, tolerance)
    """

    parts: tuple[DrawnPart, ...]
    dimensions: Mapping[str, tuple[float, float]]

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Least and greatest x, least and greatest y."""
        corners = [corner for part in self.parts for corner in part.corners_mm()]
        along, across = [x for x, _ in corners], [y for _, y in corners]
        return min(along), max(along), min(across), max(across)


def drawing_of(design: Design, values: Condition) -> Drawing | None:
    """Return the drawing of a finished design; None where the file says of no part how it looks."""
    parts = []
    for name, part in design.parts.items():
        x_mm, y_mm = (float(coordinate(values)) for coordinate in part.from_mm)
        angle_rad = math.radians(float(part.angle_deg(values)))
        sizes = float(part.length_mm(values)), float(part.width_mm(values))
        parts.append(DrawnPart(name, x_mm, y_mm, *sizes, angle_rad))
        if part.mirrored:
            parts.append(DrawnPart(f"{name} (mirrored)", x_mm, -y_mm, *sizes, -angle_rad))
    if not parts:
        return None
    return Drawing(
        tuple(parts),
        {name: (float(values[name]), tolerance) for name, tolerance in design.dimensions.items()},
    )
