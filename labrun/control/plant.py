"""The model a feed-forward inverts: a first-order lag with dead time, or a transfer function."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from labrun.errors import SpecError
from labrun.toml import KeyPath, Table, TableFaults, parsed, suggest, text_of

_KEYS = ("gain", "lag_s", "dead_s", "numerator", "denominator")

Seconds = Annotated[float, Field(ge=0)]
Coefficients = Annotated[list[float], Field(min_length=1)]


class TransferTable(Table):
    """A transfer function as a table.

    Attributes
    ----------
    gain, lag_s, dead_s
        ``gain exp(-dead_s s) / (lag_s s + 1)``, the form of (5.5) and (5.6) of the source; gain in the unit of the
        output per unit of the input.
    numerator, denominator
        Instead of gain and lag: coefficients of s, highest power first.
    """

    gain: float | None = None
    lag_s: Seconds = 0.0
    dead_s: Seconds = 0.0
    numerator: Coefficients | None = None
    denominator: Coefficients | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        with TableFaults() as faults:
            if self.numerator is None and self.denominator is None:
                if self.gain is None:
                    faults.add(None, "a model needs its gain, or numerator and denominator")
            elif self.numerator is None or self.denominator is None:
                faults.add(None, "a transfer function has both a numerator and a denominator")
            elif self.gain is not None:
                faults.add(
                    "gain", "a transfer function has its gain in its coefficients; leave out one of the two"
                )
        return self


class PlantModel(TransferTable):
    """What the feedback does when the variable is set."""

    @model_validator(mode="after")
    def _has_a_static_gain(self) -> Self:
        with TableFaults() as faults:
            if self.gain == 0:
                faults.add("gain", "0 cannot be inverted: the variable would have no effect")
            elif self.numerator and self.denominator and not (self.denominator[-1] and self.numerator[-1]):
                faults.add(
                    None, "the transfer function has no static gain to invert: a last coefficient is 0"
                )
        return self

    @property
    def static_gain(self) -> float:
        """What the feedback settles at per unit of the variable."""
        if self.numerator is not None and self.denominator is not None:
            return self.numerator[-1] / self.denominator[-1]
        if self.gain is None:
            raise SpecError("the model has no gain")
        return self.gain


def read_plant(path: Path, response: str | None = None) -> dict[str, Any]:
    """Return the keys of a `PlantModel` from the file of a fitted model.

    `path`: a TOML file with these keys, or with a table of them for each response, as the fits write it. `response`:
    which table; not needed where there is one. Raises SpecError: the file cannot be read, holds no such model, or
    several and none is named.
    """
    data = parsed(text_of(path, kind=SpecError, what="model file"), str(path), kind=SpecError)
    table, _ = response_table(data, f"model file {path}", response)
    plant = {key: table[key] for key in _KEYS if key in table}
    if (
        "numerator" in plant and "denominator" in plant
    ):  # a fit may say both: the coefficients are the whole of it
        plant.pop("gain", None)
        plant.pop("lag_s", None)
    return plant


def response_table(
    data: Mapping[str, Any], file: str, response: str | None
) -> tuple[Mapping[str, Any], KeyPath]:
    """Return the table with the transfer function of a response, and its path in the file.

    Raises
    ------
    SpecError
        There is none, none of that name, or several and none is named; `file` is what it is called.
    """
    if response is None and _is_model(data):
        return data, ()
    tables = {key: table for key, table in data.items() if isinstance(table, dict) and _is_model(table)}
    if not tables:
        raise SpecError(
            f"{file} has neither gain nor numerator: it is not a fitted response",
            hint="labrun fit fin-step --model fopdt writes one",
        )
    if response is None and len(tables) > 1:
        raise SpecError(
            f"{file} holds {len(tables)} responses: {', '.join(tables)}",
            hint=f'say which: response = "{next(iter(tables))}"',
        )
    chosen = next(iter(tables)) if response is None else response
    if chosen not in tables:
        raise SpecError(f'{file} has no response "{chosen}"', hint=suggest(chosen, tables, kind="responses"))
    return tables[chosen], (chosen,)


def _is_model(table: Mapping[str, Any]) -> bool:
    return bool(table.keys() & {"gain", "numerator"}) and not isinstance(table.get("gain"), dict)
