"""Score a whole check: shares by strength, confusion, false alarms, calibration, shrinkage."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from labrun.blind.judging import KINDS, STRENGTHS, Judged, held, sizes_held

_TENTHS = 10


@dataclass(frozen=True, slots=True)
class Share:
    """So many hits of so many."""

    hits: int
    of: int

    @classmethod
    def among(cls, found: Iterable[bool]) -> "Share":
        """Count what is true."""
        every = list(found)
        return cls(sum(every), len(every))

    @property
    def value(self) -> float | None:
        """The share; None of nothing."""
        return self.hits / self.of if self.of else None

    @property
    def ci95(self) -> tuple[float, float] | None:
        """Exact 95 % interval (Clopper and Pearson, Biometrika 26, 1934); None of nothing."""
        if not self.of:
            return None
        from scipy.stats import binomtest

        interval = binomtest(self.hits, self.of).proportion_ci(0.95, method="exact")
        return float(interval.low), float(interval.high)

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        interval = self.ci95
        return {
            "share": self.value,
            "hits": self.hits,
            "of": self.of,
            "ci95": None if interval is None else list(interval),
        }


@dataclass(frozen=True, slots=True)
class Bin:
    """Causes whose stated confidence lies in one tenth.

    Attributes
    ----------
    stated
        Mean of what was stated.
    right
        The share that was right.
    by_chance
        Mean of |stated - right| if each cause were right with the very probability that is stated.
    """

    low: float
    high: float
    stated: float
    right: Share
    by_chance: float


@dataclass(frozen=True, slots=True)
class Reliability:
    """Stated confidence against what came true, tenth by tenth; tenths that nothing fell into are left out."""

    bins: tuple[Bin, ...]

    @property
    def error(self) -> float | None:
        """Expected calibration error: |stated - right|, weighed by how often (Naeini et al., AAAI 2015)."""
        return self._weighed(abs(one.stated - one.right.hits / one.right.of) for one in self.bins)

    @property
    def error_by_chance(self) -> float | None:
        """Mean of that error if every stated confidence were exactly true: few cases cannot show a smaller one."""
        return self._weighed(one.by_chance for one in self.bins)

    def _weighed(self, errors: Iterable[float]) -> float | None:
        total = sum(one.right.of for one in self.bins)
        if not total:
            return None
        return sum(one.right.of * error for one, error in zip(self.bins, errors, strict=True)) / total

    def to_json(self) -> dict[str, Any]:
        """Return it JSON-ready."""
        return {
            "expected_calibration_error": self.error,
            "by_chance": self.error_by_chance,
            "table": [
                {"from": one.low, "to": one.high, "stated": one.stated, "right": one.right.to_json()}
                for one in self.bins
            ],
        }


ByStrength = Mapping[str, Share]


@dataclass(frozen=True, slots=True)
class ShrinkageScore:
    """Predicted against true shrinkage.

    Attributes
    ----------
    differences
        Predicted less true share of the excess removed, case by case.
    covered
        How many true shares lie in their 90 % interval.
    too_small
        Cases left out because their fresh excess is lost in the noise; `failed` those that could not be computed;
        `unpredicted` those in which a cause was announced without saying how much it removes.
    """

    differences: Mapping[str, float]
    covered: Share
    too_small: int
    failed: int
    unpredicted: int

    @property
    def median_difference(self) -> float | None:
        """Median of the absolute differences."""
        return median(map(abs, self.differences.values())) if self.differences else None


@dataclass(frozen=True, slots=True)
class Scores:
    """Figures of a check.

    Attributes
    ----------
    kinds : kind -> count
        How many cases of each kind there are; kinds without any are left out.
    named : strength -> share
        Single hidden effects that were named, alone or in a set of at most two, the effect alone counting; `sites` the
        share of those at the right site.
    pairs : strength -> outcome -> count
        Two hidden effects: both, one or none of them named.
    pair_sites
        Right sites among the members of pairs that were named.
    parameters
        Parameters far off that were named.
    set_sizes : size -> count
        Of all announced causes.
    confusion : what it is -> what was said -> count
    false_alarms
        Controls in which an effect was blamed, of those that were diagnosed; `control_claims` counts every verdict.
    recognised : strength -> share
        Of those outside of the library: called so. `recognised_from_half`: of those of at least half a unit.
    wrongly_unknown
        Of all others that were diagnosed: called outside of the library.
    extra
        Cases with more effects announced than there are.
    calibration
        Confidence of every announced cause against whether it, or its first rival, was a true one, site included. Of
        one kind of case alone it says nothing about the confidence, which is one over all kinds.
    sizes_covered
        Sizes of announced causes that are true ones: how many are within their 95 % interval.
    by_data : kind of data -> share
        Cases that came out as one would wish, by repeats, noise and what differs by trial.
    errors
        Cases that were not diagnosed.
    """

    cases: int
    kinds: Mapping[str, int]
    named: ByStrength
    sites: Share
    pairs: Mapping[str, Mapping[str, int]]
    pair_sites: Share
    parameters: Share
    set_sizes: Mapping[int, int]
    confusion: Mapping[str, Mapping[str, int]]
    false_alarms: Share
    control_claims: Mapping[str, int]
    recognised: ByStrength
    recognised_from_half: Share
    wrongly_unknown: Share
    extra: Share
    calibration: Reliability
    shrinkage: ShrinkageScore
    sizes_covered: Share
    by_data: ByStrength
    seconds: Mapping[str, float]
    errors: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """Return them JSON-ready."""
        difference = self.shrinkage
        return {
            "cases": self.cases,
            "kinds": dict(self.kinds),
            "named": _shares(self.named),
            "site_right": self.sites.to_json(),
            "pairs": {
                "by_strength": {strength: dict(count) for strength, count in self.pairs.items()},
                "site_right": self.pair_sites.to_json(),
            },
            "parameter_named": self.parameters.to_json(),
            "set_sizes": {str(size): count for size, count in self.set_sizes.items()},
            "confusion": {true: dict(said) for true, said in self.confusion.items()},
            "false_alarms": self.false_alarms.to_json(),
            "controls": dict(self.control_claims),
            "not_in_library": {
                "recognised": _shares(self.recognised),
                "recognised_from_0.5": self.recognised_from_half.to_json(),
                "wrongly_claimed": self.wrongly_unknown.to_json(),
            },
            "more_effects_than_there_are": self.extra.to_json(),
            "calibration": self.calibration.to_json(),
            "shrinkage": {
                "median_difference": difference.median_difference,
                "covered_by_ci90": difference.covered.to_json(),
                "differences": dict(difference.differences),
                "excess_too_small": difference.too_small,
                "not_computed": difference.failed,
                "not_predicted": difference.unpredicted,
            },
            "sizes_covered_by_ci95": self.sizes_covered.to_json(),
            "by_data": _shares(self.by_data),
            "seconds": dict(self.seconds),
            "errors": list(self.errors),
        }


def score(judged: Sequence[Judged]) -> Scores:
    """Score cases that were judged one by one."""
    of_kind = {kind: [one for one in judged if one.truth.kind == kind] for kind in KINDS}
    singles, pairs, outside = of_kind["effect"], of_kind["pair"], of_kind["outside"]
    controls, parameters = of_kind["control"], of_kind["parameter"]
    # a case that raised had no occasion for a false claim: it must not make them look rarer
    spoken = [one for one in judged if one.truth.kind != "outside" and not one.said.error]
    announced = [(named, one.truth) for one in judged for named in one.said.announced]
    return Scores(
        cases=len(judged),
        kinds={kind: len(those) for kind, those in of_kind.items() if those},
        named=_by_strength(singles, lambda one: one.found == 1),
        sites=Share(sum(one.sites for one in singles), sum(one.found for one in singles)),
        pairs={
            strength: dict(
                sorted(Counter(one.outcome for one in pairs if one.truth.strength == strength).items())
            )
            for strength in STRENGTHS
            if any(one.truth.strength == strength for one in pairs)
        },
        pair_sites=Share(sum(one.sites for one in pairs), sum(one.found for one in pairs)),
        parameters=Share.among(one.found == 1 for one in parameters),
        set_sizes=dict(sorted(Counter(len(named.members) for named, _ in announced).items())),
        confusion=confusion(judged),
        false_alarms=Share.among(one.outcome == "false-alarm" for one in controls if not one.said.error),
        control_claims=dict(sorted(Counter(one.said.verdict for one in controls).items())),
        recognised=_by_strength(outside, lambda one: one.outcome == "recognised"),
        recognised_from_half=Share.among(
            one.outcome == "recognised" for one in outside if one.truth.strength != STRENGTHS[0]
        ),
        wrongly_unknown=Share.among(one.said.verdict == "not-in-library" for one in spoken),
        extra=Share.among(one.extra > 0 for one in spoken),
        calibration=reliability([(named.confidence, held(named, truth)) for named, truth in announced]),
        shrinkage=shrinkage_score(judged),
        sizes_covered=Share.among(inside for one in judged for inside in sizes_held(one)),
        by_data={
            data: Share.among(one.good for one in judged if data in one.truth.data)
            for data in sorted({data for one in judged for data in one.truth.data})
        },
        seconds=_durations([one.said.seconds for one in judged if not one.said.error]),
        errors=[one.truth.case for one in judged if one.said.error],
    )


def confusion(judged: Sequence[Judged]) -> dict[str, dict[str, int]]:
    """Count what was said of what: an effect for each id (the first that is announced), a verdict where none was."""
    table: dict[str, Counter[str]] = {}
    for one in judged:
        table.setdefault(_true_name(one), Counter())[_said_name(one)] += 1
    return {true: dict(sorted(table[true].items())) for true in sorted(table)}


def shrinkage_score(judged: Sequence[Judged]) -> ShrinkageScore:
    """Compare predicted and true shrinkage of all cases in which a cause was announced."""
    differences: dict[str, float] = {}
    covered: list[bool] = []
    too_small = failed = unpredicted = 0
    for one in judged:
        predicted, shown = one.said.shrinkage, one.shown
        if not one.said.announced:
            continue
        if predicted is None:
            unpredicted += 1
        elif shown is None or shown.value is None:
            failed += 1
        elif not shown.counted:
            too_small += 1
        else:
            differences[one.truth.case] = predicted.value - shown.value
            covered.append(predicted.low <= shown.value <= predicted.high)
    return ShrinkageScore(differences, Share.among(covered), too_small, failed, unpredicted)


def reliability(stated: Sequence[tuple[float, bool]]) -> Reliability:
    """Sort (confidence, was right) into tenths. Raises ValueError: a confidence outside of 0 to 1."""
    sorted_in: list[list[tuple[float, bool]]] = [[] for _ in range(_TENTHS)]
    for confidence, right in stated:
        if not 0.0 <= confidence <= 1.0:
            raise ValueError(f"a confidence of {confidence} is no probability")
        sorted_in[min(int(confidence * _TENTHS), _TENTHS - 1)].append((confidence, right))
    return Reliability(
        tuple(
            Bin(
                place / _TENTHS,
                (place + 1) / _TENTHS,
                sum(confidence for confidence, _ in members) / len(members),
                Share.among(right for _, right in members),
                _by_chance([confidence for confidence, _ in members]),
            )
            for place, members in enumerate(sorted_in)
            if members
        )
    )


def _by_strength(judged: Sequence[Judged], hit: Callable[[Judged], bool]) -> dict[str, Share]:
    return {
        strength: Share.among(hit(one) for one in judged if one.truth.strength == strength)
        for strength in STRENGTHS
    }


def _true_name(one: Judged) -> str:
    truth = one.truth
    if truth.kind in ("control", "outside"):
        return f"({truth.kind})"
    if truth.kind == "parameter":
        return "(parameter)"
    return " + ".join(sorted(cause.effect for cause in truth.causes))


def _said_name(one: Judged) -> str:
    if one.said.error:
        return "(error)"
    announced = one.said.announced
    if not announced:
        return (
            f"({one.said.verdict}, no cause)" if one.said.verdict == "parameter" else f"({one.said.verdict})"
        )
    names = ["(parameter)" if named.top.kind == "parameter" else named.top.effect for named in announced]
    return " + ".join(sorted(names)) if one.truth.kind == "pair" else names[0]


def _durations(seconds: Sequence[float]) -> dict[str, float]:
    if not seconds:
        return {}
    ordered = sorted(seconds)
    # the nearest rank: a time that was really taken
    ninetieth = ordered[max(0, -(-9 * len(ordered) // 10) - 1)]
    return {"median": median(ordered), "of_nine_in_ten_at_most": ninetieth, "longest": ordered[-1]}


def _shares(shares: ByStrength) -> dict[str, Any]:
    return {strength: share.to_json() for strength, share in shares.items()}


def _by_chance(confidences: Sequence[float]) -> float:
    """Return the mean distance of the share of hits from the mean of their probabilities, exactly."""
    # of 0, 1, ... hits: one more factor for each cause (Poisson's binomial distribution)
    chances = np.ones(1)
    for confidence in confidences:
        chances = np.convolve(chances, (1.0 - confidence, confidence))
    count = len(confidences)
    distances = np.abs(np.arange(count + 1) / count - sum(confidences) / count)
    return float(chances @ distances)
