"""What a diagnosis says: the verdict, where, which, how far, and what it does not know."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect


@dataclass(frozen=True, slots=True)
class Learnable:
    """What any model could gain at least: the part of the squares left that a regression without physics predicts.

    Attributes
    ----------
    pieces
        In pieces of time that it did not see, of conditions that it knows.
    conditions
        In conditions that it did not see; None where there is one only.
    why_no_noise
        What tells besides that it is no noise, in words; "" if nothing does.
    """

    pieces: float
    conditions: float | None
    why_no_noise: str = ""

    @property
    def sentence(self) -> str:
        """What it says."""
        most = round(100 * max(self.pieces, self.conditions or 0.0))
        learned = f"at least {most} %" if most else "nothing"
        if self.why_no_noise:
            but = f"and {self.why_no_noise}" if most else f"but {self.why_no_noise}: it is no noise"
            return f"Of what is left, {learned} could be learned, {but}"
        rest = (
            f", at most {100 - most} % is noise"
            if most
            else ": it is noise, or goes with what was not recorded"
        )
        return f"Of what is left, {learned} could be learned{rest}"


@dataclass(frozen=True, slots=True)
class BeyondScatter:
    """What a fit leaves that is no trial's own.

    Attributes
    ----------
    learnable
        Part of the squared residual that is predicted of withheld pieces, 0 to 1.
    size
        Root mean square, in units of the noise of the mean of repeats.
    chance_of_lines
        How probable it is that noise has such lines in its spectrum.
    """

    learnable: float = 0.0
    size: float = 0.0
    chance_of_lines: float = 1.0


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
        law = " ".join(f"{one.size:+.3g} {one.formula}" for one in self.terms).removeprefix("+")
        often = ", ".join(f"{100 * one.chosen:.0f} %" for one in self.terms)
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
            "terms": [asdict(one) for one in self.terms],
            "share_on_withheld": self.share,
            "before": self.before,
            "after": self.after,
            "toml": self.toml,
            "tried": self.tried,
        }


Verdict = Literal["no-gap", "undecided", "parameter", "explained", "partly-explained", "not-in-library"]
CandidateVerdict = Literal["cause", "ruled-out", "not-visible", "indistinguishable"]
By = Literal["channel", "condition", "phase", "frequency", "state", "reversal", "equation"]
CauseKind = Literal["effect", "parameter"]


_PROPER = ("coulomb", "stribeck", "reynolds")


def effect_words(effect: str) -> str:
    """Return an effect's id as words, with the capitals of people's names."""
    words = [word.capitalize() if word in _PROPER else word for word in effect.split("-")]
    if "dependent" in words[1:]:
        place = words.index("dependent", 1)
        words[place - 1 : place + 1] = [f"{words[place - 1]}-dependent"]
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
        Probability that this, or what it is told together with, is the right one; calibrated on known cases.
    values
        Its parameters; for a parameter, its value.
    indistinguishable_from
        What explains these data about as well: the likeliest, or nothing. Further ones are marked among the candidates.
    remark
        What to know about it: at a bound, far beyond its tolerance ("1.31 times the stated value") ...
    """

    name: Name
    confidence: float
    values: Mapping[str, ResampledNumber]
    indistinguishable_from: tuple[Name, ...] = ()
    remark: str = ""


@dataclass(frozen=True)
class RatedCandidate:
    """What was found about one candidate.

    Attributes
    ----------
    held_out_share
        Share of the recalibrated excess it removes on conditions its fit did not see; None where that was not tried.
    evidence
        How much the squared residual falls in units of the noise, beside what noise alone would give the best of all
        candidates (the guard's threshold): above 1 it is beyond chance.
    values
        As fitted (SI).
    upper_bound
        Of a candidate that is ruled out: by parameter, the largest size the data leave room for (95 %), and between
        which ends it then lies: from zero for what cannot be negative. Of a level that is out of reach without the
        effect, such as that of a saturation: the least one, and the farthest that was looked for.
    same_as
        What it cannot be told from.
    """

    name: Name
    verdict: CandidateVerdict
    held_out_share: float | None = None
    evidence: float = 0.0
    values: Mapping[str, ResampledNumber] = field(default_factory=dict)
    upper_bound: Mapping[str, ResampledNumber] = field(default_factory=dict)
    same_as: tuple[Name, ...] = ()
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """Share of the recalibrated excess that the causes remove on withheld conditions, with a 90 % interval."""

    value: float
    low: float
    high: float


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
    rest
        A law for what the causes leave, where one was asked for.
    learnable
        What any model could gain on what is left; None where nothing is left beyond noise.
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
    guard: str
    seed: int
    seconds: float
    rest: RestLaw | None = None
    learnable: Learnable | None = None

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --json`` prints."""
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "name": self.name,
            "model": self.model,
            "source": self.source,
            "gap": asdict(self.gap),
            "where": [asdict(place) for place in self.where],
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
                name: {"stated": stated, "tolerance": tolerance, "recalibrated": found}
                for name, (stated, tolerance, found) in self.recalibration.items()
            },
            "corrected": dict(self.corrected),
            "effects": [
                {
                    "effect": one.effect.id,
                    "kind": one.effect.kind,
                    "site": one.site,
                    "values": list(one.values),
                }
                for one in self.effects
            ],
            "limitations": list(self.limitations),
            "notes": list(self.notes),
            "what_next": list(self.what_next),
            "noise": dict(self.noise),
            "data": {"trials": self.trials, "conditions": self.conditions, "repeats": self.repeats},
            "guard": self.guard,
            "seed": self.seed,
            "seconds": round(self.seconds, 2),
            "learnable": None
            if self.learnable is None
            else {
                "pieces_of_time": self.learnable.pieces,
                "conditions": self.learnable.conditions,
                "why_no_noise": self.learnable.why_no_noise,
            },
            **({} if self.rest is None else {"rest": self.rest.to_json()}),
        }


def cause_json(cause: Cause) -> dict[str, Any]:
    """Return a cause as every ``--json`` of a diagnosis prints it."""
    return {
        **cause.name.to_json(),
        "confidence": cause.confidence,
        "values": _estimates(cause.values),
        "indistinguishable_from": _names(cause.indistinguishable_from),
        "remark": cause.remark,
    }


def _candidate(candidate: RatedCandidate) -> dict[str, Any]:
    return {
        **candidate.name.to_json(),
        "verdict": candidate.verdict,
        "held_out_share": candidate.held_out_share,
        "evidence": candidate.evidence,
        "values": _estimates(candidate.values),
        "upper_bound": _estimates(candidate.upper_bound),
        "indistinguishable_from": _names(candidate.same_as),
        "remark": candidate.remark,
    }


def _estimates(values: Mapping[str, ResampledNumber]) -> dict[str, Any]:
    return {name: one.to_json() for name, one in values.items()}


def _names(names: Sequence[Name]) -> list[dict[str, str]]:
    return [name.to_json() for name in names]
