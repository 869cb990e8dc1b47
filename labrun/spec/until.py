"""When a trial ends by what it measures: a condition on each cycle's numbers, in the one language of expressions."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import PositiveInt

from labrun.spec.raw import check_name, table
from labrun.toml import Expression, ExpressionError, Fault, KeyPath, Table, fault_of

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

    Every cycle's objectives are kept, and the samples of one cycle in `keep_every`.
    """

    when: str
    max_cycles: PositiveInt
    keep_every: PositiveInt = 100


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
        found: dict[str, _Summary] = {}

        def taken(match: re.Match[str]) -> str:
            function, objective, end, count = match.groups()
            if objective is None and len(named) != 1:
                example = f"{function}({(named or ['NAME'])[0]}, {end} {count})"
                raise ExpressionError(text, f"{match[0]} of which objective? write {example}", match.start())
            if int(count) == 0:
                raise ExpressionError(text, f"{match[0]} is of no cycle", match.start())
            one = _Summary(function, objective or named[0], end, int(count))
            name = f"{function}_{end}_{count}_of_{one.objective}"
            found[name] = one
            return name

        plain = _SUMMARY.sub(taken, text)
        if half := re.search(r"\bmedian\b|\bmean\b|\b(first|last)\s+\d", plain):
            hint = f"{text[half.start() :][:20]!r} is no summary of cycles; one reads median(first 100)"
            raise ExpressionError(text, hint, half.start())
        expression = Expression.of(plain)
        if not expression.is_comparison:
            raise ExpressionError(
                text, 'compares nothing; a condition reads "peak < 0.2 * median(first 100)"'
            )
        return cls(text, expression, found)

    @property
    def names(self) -> list[str]:
        """The objectives that it is about, and perhaps ``cycle``."""
        plain = [name for name in self.expression.names if name not in self.summaries]
        return list(dict.fromkeys([*plain, *(one.objective for one in self.summaries.values())]))

    def holds(self, history: Mapping[str, Sequence[float]]) -> bool:
        """Tell whether it holds after the latest of the cycles; `history` has an objective's value of each."""
        values: dict[str, float] = {name: cycles[-1] for name, cycles in history.items()}
        values[CYCLE] = float(max(len(cycles) for cycles in history.values()))
        for name, one in self.summaries.items():
            summary = one.of(history[one.objective])
            if summary is None:
                return False
            values[name] = summary
        return bool(self.expression(values))


def check_until(data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield what does not fit between trial.until and the rest of the file."""
    trial, until = table(data, "trial"), table(data, "trial", "until")
    if not until:
        return
    objectives = [name for name, one in table(data, "objectives").items() if name != CYCLES]
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
                max((one.count for one in criterion.summaries.values()), default=0),
            )
            if isinstance(most, int) and 0 < most < first:
                complaint = f"nothing would ever be judged: the condition wants {first} cycles"
                yield Fault(("trial", "until", "max_cycles"), complaint, at_value=True)
    if CYCLE in objectives:
        yield Fault(("objectives", CYCLE), "the number of the cycle has this name; choose another one")
    own = table(data, "objectives", CYCLES)
    if own and own.get("plugin") != CYCLES:
        yield Fault(("objectives", CYCLES), "the number of cycles has this name; choose another one")
    if CYCLES in table(data, "rig", "devices"):
        yield Fault(
            ("rig", "devices", CYCLES),
            "the numbers of the cycles are stored by this name; choose another one",
        )
    if "carriage" in trial:
        yield Fault(("trial", "carriage"), "its travel ends; a trial with until stays where it is")
    if trial.get("on_fault", "stop") != "stop":
        text = "with until a fault ends the run, so that labrun resume goes on with the same cycles"
        yield Fault(("trial", "on_fault"), text, at_value=True)
    if data.get("kind") == "track":
        yield Fault(("trial", "until"), "a closed loop runs for a number of cycles, or a duration")
