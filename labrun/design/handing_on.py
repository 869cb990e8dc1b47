"""A finished design as others take it: a table of its dimensions, its model, and experiments on its rig."""

import csv
import io
from collections.abc import Mapping

import tomli_w

from labrun.design.simulator import Simulator
from labrun.errors import RequestError
from labrun.models import corrected_model_text, load_model
from labrun.spec import Condition, Design, WrittenExperiment
from labrun.toml import KeyPath, locate, replaced, suggest

MADE = "# Written by labrun design"
"""How a file begins that a design has written, and a later one may replace."""


def dimensions_csv(design: Design, values: Condition, units: Mapping[str, str]) -> str:
    """Return the variables of a design as a table: name, value, tolerance, unit, range; those to be built first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("name", "value", "tolerance", "unit", "from", "to"))
    ordered = sorted(design.variables, key=lambda name: design.variables[name].tolerance == 0)
    for name in ordered:
        one = design.variables[name]
        tolerance = one.tolerance or ""
        writer.writerow(
            (name, f"{float(values[name]):.6g}", tolerance, units.get(name, ""), one.start, one.stop)
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
    given: dict[str, float | str] = {name: float(one(values)) for name, one in written.values.items()}
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
    keep = "# A later design replaces this file. Take these two lines away to keep it."
    return "\n".join([about, keep, replaced(template, places)])


def _as_toml(value: float | str) -> str:
    return tomli_w.dumps({"a": value}).removeprefix("a = ").strip()
