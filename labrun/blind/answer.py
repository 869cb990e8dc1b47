"""The answer on which a diagnosis is scored, for labrun and other programs.

`Answer` is what ``labrun gap check --tool`` reads from a program's standard output. Of labrun it is read from what
``labrun gap diagnose --json`` prints.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StrictBool, ValidationError

HALF = 0.5
"""A cause that closes this share of the gap is claimed, whatever the verdict."""
UNEXPLAINED = 0.1
"""A rest of at least this share of the gap is told as unexplained; a smaller one counts as explained."""
_ANNOUNCING = ("explained", "mostly-explained", "partly-explained")
_WITHOUT_GAP = ("no-gap", "cannot-tell")
_LONGEST_REASON = 300


class CauseName(BaseModel):
    """An effect at a site, or, with an empty site, a parameter of the model whose value is off."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    effect: Annotated[str, Field(min_length=1)]
    site: str = ""

    @classmethod
    def of_diagnosis(cls, named: Mapping[str, Any]) -> "CauseName":
        """Read one as an answer of the generator or a diagnosis of labrun writes it."""
        is_parameter = named.get("kind") == "parameter"
        return cls(effect=named["effect"], site="" if is_parameter else named.get("site") or "")

    def has_effect_of(self, other: "CauseName") -> bool:
        """Tell whether both are the same effect at any site, or the same parameter."""
        return self.effect == other.effect and bool(self.site) == bool(other.site)

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}" if self.site else f"parameter {self.effect}"


class Size(BaseModel):
    """A parameter of an effect, SI, with its 95 % interval where there is one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    value: FiniteFloat
    ci95: tuple[FiniteFloat, FiniteFloat] | None = None
    unit: str = ""


class Cause(BaseModel):
    """A cause that is claimed.

    Attributes
    ----------
    effect, site
        The library's id and the model's name of the site; of a parameter of the model, its name and "".
    size : parameter of the effect -> value
        None or empty where the program does not tell it.
    closes
        Share of the gap that this cause closes; None where that is not told, which counts as less than half.
    rivals
        What the data cannot tell from it: the set that is claimed, together with the cause.
    confidence
        Probability that this cause, or the first of its rivals, is a true one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    effect: Annotated[str, Field(min_length=1)]
    site: str = ""
    size: dict[str, Size] = Field(default_factory=dict)
    closes: FiniteFloat | None = None
    rivals: tuple[CauseName, ...] = ()
    confidence: Annotated[float, Field(ge=0.0, le=1.0)] | None = None

    @property
    def name(self) -> CauseName:
        """The cause without its rivals."""
        return CauseName(effect=self.effect, site=self.site)

    @property
    def members(self) -> tuple[CauseName, ...]:
        """The set that is claimed to hold the true cause, the leading one first."""
        return tuple(dict.fromkeys((self.name, *self.rivals)))

    @property
    def closes_half(self) -> bool:
        """Tell whether the cause is stated to close at least half of the gap."""
        return self.closes is not None and self.closes >= HALF

    def __str__(self) -> str:
        return " or ".join(str(member) for member in self.members)

    @classmethod
    def of_diagnosis(cls, cause: Mapping[str, Any]) -> "Cause":
        """Read a cause of ``labrun gap diagnose --json``."""
        name = CauseName.of_diagnosis(cause)
        return cls(
            effect=name.effect,
            site=name.site,
            size={
                key: _size(value)
                for key, value in cause.get("values", {}).items()
                if value["value"] is not None
            },
            closes=cause.get("closes"),
            rivals=tuple(CauseName.of_diagnosis(rival) for rival in cause["indistinguishable_from"]),
            confidence=cause.get("confidence"),
        )


class Answer(BaseModel):
    """What a program says of one recording.

    Attributes
    ----------
    gap
        Whether a gap beyond noise is reported that recalibrating the parameters does not close.
    causes
        The causes that are claimed.
    rest
        Share of the gap that is left unexplained, 0 to 1; None where nothing is said of it.
    """

    model_config = ConfigDict(frozen=True)

    gap: StrictBool
    causes: tuple[Cause, ...]
    rest: Annotated[float, Field(ge=0.0, le=1.0)] | None = None

    @property
    def tells_rest(self) -> bool:
        """Tell whether a part of the gap is reported as unexplained."""
        return self.rest is not None and self.rest >= UNEXPLAINED

    @classmethod
    def of_diagnosis(cls, printed: Mapping[str, Any]) -> "Answer":
        """Read what ``labrun gap diagnose --json`` prints.

        A cause is claimed if the verdict announces causes, or if it closes at least half of the gap.

        Raises
        ------
        ValidationError
            A number that is out of its range.
        """
        verdict, rest = printed["verdict"], printed["rest"] or {}
        causes = tuple(Cause.of_diagnosis(cause) for cause in printed["causes"])
        return cls(
            gap=verdict not in _WITHOUT_GAP,
            causes=causes
            if verdict in _ANNOUNCING
            else tuple(cause for cause in causes if cause.closes_half),
            rest=0.0 if rest.get("within_noise") else min(rest.get("share_of_gap", 1.0), 1.0),
        )


def reason_of(error: ValidationError) -> str:
    """Return the faults of an answer in one line, each field with what was expected."""
    faults = [
        f"{'.'.join(str(key) for key in fault['loc']) or 'the answer'}: {fault['msg'].lower()}"
        for fault in error.errors()
    ]
    return "; ".join(faults)[:_LONGEST_REASON]


def _size(value: Mapping[str, Any]) -> Size:
    low, high = value["ci95"]
    interval = None if low is None or high is None else (low, high)
    return Size(value=value["value"], ci95=interval, unit=value.get("unit") or "")
