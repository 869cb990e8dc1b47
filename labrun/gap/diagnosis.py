"""What a diagnosis says: the verdict, where, which, how far, and what it does not know."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect


@dataclass(frozen=True, slots=True)
class Rung:
    """A step of the ladder: the error on unseen data once something has been added to the model.

    Attributes
    ----------
    step
        What was added: "as stated", "recalibrated", or a cause in words.
    cause
        Name of the cause that was added; None for the first two steps.
    errors : output -> root mean square of measured minus simulated, in the output's unit
        The noise of the measurement is part of it.
    in_noise
        Root mean square of the systematic part over all outputs, in units of one trial's noise.
    closes
        Share of the recalibrated gap that this step closes; 0 for the first two steps.
    """

    step: str
    cause: "Name | None"
    errors: Mapping[str, float]
    in_noise: float
    closes: float

    def to_json(self, units: Mapping[str, str]) -> dict[str, Any]:
        """Return it as ``--json`` prints it."""
        return {
            "step": self.step,
            "cause": None if self.cause is None else self.cause.to_json(),
            "errors": {name: {"value": value, "unit": units[name]} for name, value in self.errors.items()},
            "in_noise": self.in_noise,
            "closes": self.closes,
        }


@dataclass(frozen=True, slots=True)
class Rest:
    """What the causes leave; it is described and never used to withdraw them.

    Attributes
    ----------
    in_noise
        Root mean square of what is left on unseen data, in units of one trial's noise.
    share_of_gap
        The same as a share of the recalibrated gap.
    nested
        As `in_noise`, with causes that were chosen without the condition that they predict; None where no cause was
        chosen.
    predictable
        Share of its square that a regression on motion, inputs and their recent past predicts of pieces of time that
        the regression has not seen, 0 to 1. None where it was not asked.
    depends_on
        Signals that predict most of that by themselves, in words.
    within_noise
        Whether repeats, or a stated reading error, show that noise alone leaves as much.
    """

    in_noise: float
    share_of_gap: float
    predictable: float | None = None
    depends_on: tuple[str, ...] = ()
    within_noise: bool = False
    nested: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it as ``--json`` prints it."""
        return {
            "in_noise": self.in_noise,
            "in_noise_nested": self.nested,
            "share_of_gap": self.share_of_gap,
            "predictable": self.predictable,
            "depends_on": list(self.depends_on),
            "within_noise": self.within_noise,
        }


@dataclass(frozen=True)
class Term:
    """A term of a law.

    Attributes
    ----------
    formula
        In multiples of what is typical, as the effect's file writes it.
    size
        At typical motion, in `unit`.
    chosen
        Share of resamples of the trials in which it was chosen again.
    """

    formula: str
    size: float
    unit: str
    chosen: float


@dataclass(frozen=True)
class RestLaw:
    """What a law of a few terms explains of the rest that a diagnosis leaves.

    Attributes
    ----------
    terms
        None where no law predicts withheld trials.
    share
        Of the rest, on trials (of one condition: blocks of time) that neither choice nor fit has seen.
    before, after
        Root mean square of the rest in units of one trial's noise, as fitted.
    toml
        The law as a file of effects; "" where there is none.
    values
        Its sizes, SI.
    corrected : parameter -> value
        Of the model refitted with it; `effects` are the causes, refitted too.
    tried
        How many terms there were to choose from.
    """

    site: str
    kind: str
    terms: tuple[Term, ...]
    share: float
    before: float
    after: float
    toml: str
    values: tuple[float, ...]
    corrected: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]
    tried: int

    @property
    def sentence(self) -> str:
        """What it says."""
        if not self.terms:
            return f"No law of up to three of {self.tried} terms predicts what is left of trials it has not seen."
        law = " ".join(f"{term.size:+.3g} {term.formula}" for term in self.terms).removeprefix("+")
        often = ", ".join(f"{100 * term.chosen:.0f} %" for term in self.terms)
        what, unit = ("force" if self.kind != "input" else "signal"), self.terms[0].unit
        return (
            f"Missing {what} at {self.site}: {law} {unit} removes {100 * self.share:.0f} % of the squares that are "
            f"left on data it has not seen (chosen again in {often} of resamples, from {self.tried} terms)."
        )

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --explain-rest --json`` prints."""
        return {
            "site": self.site,
            "kind": self.kind,
            "terms": [asdict(term) for term in self.terms],
            "share_on_withheld": self.share,
            "before": self.before,
            "after": self.after,
            "toml": self.toml,
            "tried": self.tried,
        }


Verdict = Literal["no-gap", "explained", "mostly-explained", "partly-explained", "unexplained", "cannot-tell"]
CandidateVerdict = Literal["cause", "rival", "not-needed", "excluded", "not-visible"]
By = Literal["channel", "condition", "phase", "frequency", "state", "reversal"]
CauseKind = Literal["effect", "parameter"]


_PROPER = ("coulomb", "stribeck", "reynolds")


def effect_words(effect: str) -> str:
    """Return an effect's id as words, with the capitals of people's names."""
    words = [word.capitalize() if word in _PROPER else word for word in effect.split("-")]
    if "dependent" in words[1:]:
        index = words.index("dependent", 1)
        words[index - 1 : index + 1] = [f"{words[index - 1]}-dependent"]
    return " ".join(words)


@dataclass(frozen=True, slots=True)
class ResampledNumber:
    """A number with its 95 % interval from resampling whole trials."""

    value: float
    low: float
    high: float
    unit: str = "1"

    def to_json(self) -> dict[str, Any]:
        """Return it as every ``--json`` of the diagnosis prints it."""
        return {"value": self.value, "ci95": [self.low, self.high], "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Sizes:
    """Systematic residual, root mean square over channels, in units of one trial's noise.

    Attributes
    ----------
    raw, recalibrated, after
        With the stated parameters, with recalibrated ones, with the causes added: on conditions the fit did not see
        (where there is more than one condition, and where there are causes to compare). The noise floor is taken off.
    floor
        What noise alone leaves of such a number, at most, in 95 of 100 repetitions of the experiment.
    """

    raw: float
    recalibrated: float
    after: float
    floor: float


@dataclass(frozen=True, slots=True)
class Place:
    """A place where the recalibrated model and the measurement differ.

    Attributes
    ----------
    by, at
        The way of dividing the data, and the part: ("condition", "amplitude_deg = 40, frequency_hz = 1").
    share
        Of the excess of the squared residual over the noise floor, all of whose parts of one `by` add up to about 1.
    p
        Probability that noise alone gives this part as much, corrected for all the places looked at; None where it
        cannot be told.
    text
        `at`, for people: "the recovery stroke".
    part
        What its share would be if there were nothing special about it: the part of the data that it makes up, or, of a
        band of frequencies, of the signal's power, whichever is more. None where that means nothing.
    """

    by: By
    at: str
    share: float
    p: float | None
    text: str = ""
    part: float | None = None


@dataclass(frozen=True, slots=True)
class Name:
    """What a candidate is called: an effect at a site, or a parameter."""

    effect: str
    site: str
    kind: CauseKind = "effect"

    def __str__(self) -> str:
        return f"{self.effect} at {self.site}" if self.kind == "effect" else f"parameter {self.effect}"

    @property
    def words(self) -> str:
        """For people: ``Coulomb friction at hinge``, or ``parameter inertia``."""
        return f"{effect_words(self.effect)} at {self.site}" if self.kind == "effect" else str(self)

    def to_json(self) -> dict[str, str]:
        """Return it as every ``--json`` of the diagnosis prints it."""
        return {"kind": self.kind, "effect": self.effect, "site": self.site}


@dataclass(frozen=True)
class Cause:
    """An effect (or parameter) that the data ask for.

    Attributes
    ----------
    confidence
        How often this, or the first of its rivals, wins when the units of evidence are resampled.
    values
        Its parameters; for a parameter, its value.
    closes
        Share of the recalibrated gap that it closes on unseen data, where the ladder adds it.
    returns
        Share of the gap that comes back without it, the other causes fitted again.
    indistinguishable_from
        Its first rival, or nothing.
    rivals
        All candidates that do as well in its place by the rule, the best first.
    refers_to
        What the values refer to: an exponent, a reference speed; held, so without an interval.
    remark
        What to know about it: at a bound, far beyond its tolerance ("1.31 times the stated value") ...
    """

    name: Name
    confidence: float
    values: Mapping[str, ResampledNumber]
    closes: float = 0.0
    returns: float = 0.0
    rivals: tuple[Name, ...] = ()
    refers_to: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    remark: str = ""

    @property
    def indistinguishable_from(self) -> tuple[Name, ...]:
        """The first rival, or nothing."""
        return self.rivals[:1]


@dataclass(frozen=True)
class RatedCandidate:
    """What was found about one candidate.

    Attributes
    ----------
    closes
        Share of the recalibrated gap that it closes on unseen data by itself; None where it was not promising enough to
        be judged.
    values
        As fitted (SI).
    upper_bound
        Of a candidate that is excluded: by parameter, the largest size the data leave room for (95 %), and between
        which ends it then lies: from zero for what cannot be negative. Of a level that is out of reach without the
        effect, such as that of a saturation: the least one, and the farthest that was looked for.
    same_as
        What it cannot be told from.
    """

    name: Name
    verdict: CandidateVerdict
    closes: float | None = None
    values: Mapping[str, ResampledNumber] = field(default_factory=dict)
    upper_bound: Mapping[str, ResampledNumber] = field(default_factory=dict)
    same_as: tuple[Name, ...] = ()
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """Share of the squared recalibrated gap that the causes close of unseen data, with a 90 % interval."""

    value: float
    low: float
    high: float

    @property
    def of_gap(self) -> tuple[float, float, float]:
        """The same as shares of the gap itself (root mean square): value and ends of the interval."""
        value, low, high = (
            1.0 - math.sqrt(max(1.0 - share, 0.0)) for share in (self.value, self.low, self.high)
        )
        return value, low, high


@dataclass(frozen=True)
class MissingForce:
    """The force (or signal) that, added at a site over time, would close the recalibrated gap.

    Attributes
    ----------
    site, unit
        Where it acts.
    share
        Of the excess that it can explain.
    time_s, force, coordinate, rate, load
        Per unit of data, arrays (n,); `load` is empty where the site declares none.
    labels
        Of the units.
    coordinate_unit, load_unit
        "" where the model and the recording do not tell them. The rate is in units of the coordinate per second.
    """

    site: str
    unit: str
    share: float
    labels: tuple[str, ...]
    time_s: tuple[FloatArray, ...]
    force: tuple[FloatArray, ...]
    coordinate: tuple[FloatArray, ...]
    rate: tuple[FloatArray, ...]
    load: tuple[FloatArray, ...] = ()
    coordinate_unit: str = ""
    load_unit: str = ""


@dataclass(frozen=True)
class ComparedTrace:
    """Measured and simulated outputs of one unit of data, for pictures. All arrays (n, m)."""

    label: str
    condition: Mapping[str, float | str]
    repeats: int
    time_s: FloatArray
    inputs: FloatArray
    measured: FloatArray
    raw: FloatArray
    recalibrated: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Diagnosis:
    """The answer to: where do model and measurement differ, which effect causes it, how far does it close the gap.

    Attributes
    ----------
    sentence
        The verdict, as a sentence.
    differs
        What differs from trial to trial and was taken out of noise and gap, in words.
    recalibration : parameter -> (stated value, tolerance, recalibrated value)
        Tolerance as in the model, relative or "free".
    corrected : parameter -> value
        All parameters of the model with the causes added.
    effects
        The causes as attached effects, to be written into a corrected model.
    limitations
        What these data do not allow to say, in sentences. Never empty where something was not checked.
    notes
        Remarks on data and model, in sentences.
    what_next
        What to do now, in sentences.
    noise : output -> standard deviation of one trial
    traces
        The worst unit of each of a few conditions, those with the largest gap first.
    ladder
        Errors on unseen data: as stated, recalibrated, with each cause in turn.
    rest
        What the causes leave.
    law
        A law for it, where one was asked for.
    stopped
        Why the search ended early with its best answer so far: "interrupted" or "time"; "" where it ended by itself.
    """

    name: str
    model: str
    source: str
    verdict: Verdict
    sentence: str
    gap: Sizes
    where: tuple[Place, ...]
    causes: tuple[Cause, ...]
    differs: tuple[str, ...]
    candidates: tuple[RatedCandidate, ...]
    shrinkage: Shrinkage | None
    recalibration: Mapping[str, tuple[float, float | str, float]]
    corrected: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]
    limitations: tuple[str, ...]
    notes: tuple[str, ...]
    what_next: tuple[str, ...]
    channels: tuple[tuple[str, str], ...]
    input_channels: tuple[tuple[str, str], ...]
    noise: Mapping[str, float]
    trials: int
    conditions: int
    repeats: int
    missing: tuple[MissingForce, ...]
    traces: tuple[ComparedTrace, ...]
    parameter_units: Mapping[str, str]
    seed: int
    seconds: float
    ladder: tuple[Rung, ...]
    rest: Rest
    law: RestLaw | None = None
    stopped: str = ""

    @property
    def complete(self) -> bool:
        """Whether the search ended by itself."""
        return not self.stopped

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "name": self.name,
            "model": self.model,
            "source": self.source,
            "gap": asdict(self.gap),
            "where": [asdict(location) for location in self.where],
            "differs_by_trial": list(self.differs),
            "causes": [cause_json(cause) for cause in self.causes],
            "candidates": [_candidate(candidate) for candidate in self.candidates],
            "shrinkage": None
            if self.shrinkage is None
            else {
                "share_removed": {
                    "value": self.shrinkage.value,
                    "ci90": [self.shrinkage.low, self.shrinkage.high],
                }
            },
            "recalibration": {
                name: {"stated": stated, "tolerance": tolerance, "recalibrated": estimate}
                for name, (stated, tolerance, estimate) in self.recalibration.items()
            },
            "corrected": dict(self.corrected),
            "effects": [
                {
                    "effect": effect.effect.id,
                    "kind": effect.effect.kind,
                    "site": effect.site,
                    "values": list(effect.values),
                }
                for effect in self.effects
            ],
            "limitations": list(self.limitations),
            "notes": list(self.notes),
            "what_next": list(self.what_next),
            "noise": dict(self.noise),
            "data": {"trials": self.trials, "conditions": self.conditions, "repeats": self.repeats},
            "seed": self.seed,
            "seconds": round(self.seconds, 2),
            "complete": self.complete,
            "stopped": self.stopped,
            "ladder": [rung.to_json(dict(self.channels)) for rung in self.ladder],
            "rest": {**self.rest.to_json(), **({} if self.law is None else {"law": self.law.to_json()})},
        }


def cause_json(cause: Cause) -> dict[str, Any]:
    """Return a cause as every ``--json`` of a diagnosis prints it."""
    return {
        **cause.name.to_json(),
        "confidence": cause.confidence,
        "values": _estimates(cause.values),
        "closes": cause.closes,
        "returns_without": cause.returns,
        "indistinguishable_from": _names(cause.indistinguishable_from),
        "rivals": _names(cause.rivals),
        "refers_to": {
            name: {"value": value, "unit": unit} for name, (value, unit) in cause.refers_to.items()
        },
        "remark": cause.remark,
    }


def _candidate(candidate: RatedCandidate) -> dict[str, Any]:
    return {
        **candidate.name.to_json(),
        "verdict": candidate.verdict,
        "closes": candidate.closes,
        "values": _estimates(candidate.values),
        "upper_bound": _estimates(candidate.upper_bound),
        "indistinguishable_from": _names(candidate.same_as),
        "remark": candidate.remark,
    }


def _estimates(values: Mapping[str, ResampledNumber]) -> dict[str, Any]:
    return {name: value.to_json() for name, value in values.items()}


def _names(names: Sequence[Name]) -> list[dict[str, str]]:
    return [name.to_json() for name in names]
