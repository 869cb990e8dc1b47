"""The sealed answer of a case: what is hidden in it, how strongly, and what its recording is like."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrun.blind.answer import CauseName

KINDS = ("control", "effect", "pair", "parameter", "outside")
"""What a case may be: nothing hidden, one effect, two, a parameter far off, or physics that is not in the library."""
STRENGTHS = ("below 0.5", "0.5 to 1", "1 to 3", "3 and above")
"""Classes of the true gap after recalibration, in units of one trial's noise."""
_BOUNDS = (0.5, 1.0, 3.0)
MANY_TRIALS = 50
"""No more are drawn: ten conditions, five times each."""


@dataclass(frozen=True, slots=True)
class Truth:
    """A sealed answer.

    Attributes
    ----------
    kind
        One of `KINDS`.
    gap
        True systematic residual after recalibration, in units of one trial's noise.
    forms
        What was simulated, in words.
    noise, zeros
        Colour of the noise, and whether each trial has a zero of its own.
    conditions
        How many were recorded, each `repeats` times.
    sizes : per cause, parameter -> value
        Of the form that was simulated.
    """

    case: str
    kind: str
    causes: tuple[CauseName, ...]
    gap: float
    bench: str
    repeats: int
    seed: int
    forms: tuple[str, ...]
    noise: str = ""
    zeros: bool = False
    sizes: tuple[Mapping[str, float], ...] = ()
    conditions: int = 0

    @property
    def data(self) -> tuple[str, ...]:
        """What its recording is like, in words."""
        repeats = f"{self.repeats} repeat" + ("s" if self.repeats != 1 else "")
        return (
            repeats,
            *((f"{self.noise} noise",) if self.noise else ()),
            *(("zeros by trial",) if self.zeros else ()),
            *(("many trials",) if self.conditions * self.repeats > MANY_TRIALS else ()),
        )

    @property
    def strength(self) -> str:
        """Class of the gap, one of `STRENGTHS`."""
        return STRENGTHS[sum(self.gap >= bound for bound in _BOUNDS)]

    @classmethod
    def from_json(cls, answer: Mapping[str, Any]) -> "Truth":
        """Read an answer as the generator writes it."""
        causes = tuple(CauseName.of_diagnosis(cause) for cause in answer["causes"])
        hidden = answer.get("hidden", ())
        true = answer.get("true_parameters", {})
        released = [{cause.effect: true[cause.effect]} for cause in causes if cause.effect in true]
        return cls(
            answer["case"],
            answer["kind"],
            causes,
            float(answer["gap"]["recalibrated"]),
            answer.get("bench", ""),
            int(answer.get("repeats", 0)),
            int(answer["seed"]),
            tuple(
                f"{item.get('form', item.get('effect', '?'))} at {item.get('site', '?')}" for item in hidden
            ),
            str(answer.get("noise", {}).get("colour", "")),
            bool(answer.get("noise", {}).get("zero_by_trial", 0.0)),
            tuple(item.get("values", {}) for item in hidden) or tuple(released),
            int(answer.get("conditions", 0)),
        )
