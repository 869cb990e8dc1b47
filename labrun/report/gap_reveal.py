"""What a diagnosis said beside what was hidden, as people read it."""

from collections.abc import Mapping
from typing import Any

from labrun.blind import Compared, Revealed
from labrun.gap import Name, ResampledNumber
from labrun.report.gap_words import estimate_words
from labrun.report.text import listed, number, spaced


def compared_text(compared: Compared) -> str:
    """Return verdict and truth under each other, then what the seal says of itself."""
    hidden, seal = _hidden_lines(compared.revealed), _seal_lines(compared.revealed)
    sizes = [f"sizes     {text}" for text in compared.sizes]
    return "\n".join(
        [f"said      {_said(compared.stored)}", *hidden, f"score     {compared.score}", *sizes, *seal]
    )


def _hidden_lines(revealed: Revealed) -> list[str]:
    return [f"hidden    {one}" for one in revealed.hidden] or ["hidden    nothing"]


def _seal_lines(revealed: Revealed) -> list[str]:
    before = revealed.opened_before
    return [
        f"sealed    {revealed.sealed_at}, sha256 {revealed.sha256[:16]}, unbroken",
        f"opened    before, {len(before)} times, first {before[0]}" if before else "opened    never before",
    ]


def _said(stored: Mapping[str, Any]) -> str:
    causes = stored.get("causes", [])
    if not causes:
        return {"no-gap": "no gap", "not-in-library": "something that is not in the library"}.get(
            str(stored["verdict"]), str(stored["verdict"])
        )
    return "; ".join(_cause(cause) for cause in causes)


def _cause(cause: Mapping[str, Any]) -> str:
    name = str(Name(cause["effect"], cause["site"], cause["kind"]))
    others = [str(Name(one["effect"], one["site"], one["kind"])) for one in cause["indistinguishable_from"]]
    if others:
        name += f" (or {listed(others, 'or')})"
    values = ", ".join(_value(key, value) for key, value in cause["values"].items())
    return f"{name}: {values}" if values else name


def _value(name: str, value: Mapping[str, Any]) -> str:
    low, high = value["ci95"]
    if value["value"] is None or low is None or high is None:
        return f"{spaced(name)} = {'not known' if value['value'] is None else number(value['value'])}"
    estimate = ResampledNumber(value["value"], low, high, value["unit"])
    return f"{name} = {estimate_words(estimate, prefix=False)}"
