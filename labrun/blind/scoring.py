"""Score a whole check: shares by strength, false causes, sizes, calibration, predicted shares, processor time."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from labrun.blind.judging import Judged, is_held, sizes_held
from labrun.blind.truth import KINDS, STRENGTHS

_TENTHS = 10


@dataclass(frozen=True, slots=True)
class Share:
    """A number of hits out of a total."""

    hits: int
    of: int

    @classmethod
    def among(cls, hits: Iterable[bool]) -> "Share":
        """Count what is true."""
        every = list(hits)
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
        """Return the fields JSON-ready."""
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
        return self._weighed(
            abs(calibration_bin.stated - calibration_bin.right.hits / calibration_bin.right.of)
            for calibration_bin in self.bins
        )

    @property
    def error_by_chance(self) -> float | None:
        """Mean of that error if every stated confidence were exactly true: few cases cannot show a smaller one."""
        return self._weighed(calibration_bin.by_chance for calibration_bin in self.bins)

    def _weighed(self, errors: Iterable[float]) -> float | None:
        total = sum(calibration_bin.right.of for calibration_bin in self.bins)
        if not total:
            return None
        return (
            sum(
                calibration_bin.right.of * error
                for calibration_bin, error in zip(self.bins, errors, strict=True)
            )
            / total
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fields JSON-ready."""
        return {
            "expected_calibration_error": self.error,
            "by_chance": self.error_by_chance,
            "table": [
                {
                    "from": calibration_bin.low,
                    "to": calibration_bin.high,
                    "stated": calibration_bin.stated,
                    "right": calibration_bin.right.to_json(),
                }
                for calibration_bin in self.bins
            ],
        }


ByStrength = Mapping[str, Share]


@dataclass(frozen=True, slots=True)
class ShareScore:
    """Predicted against true shares of the excess that the causes remove.

    Attributes
    ----------
    differences
        Predicted less true share, case by case.
    covered
        How many true shares lie in their 90 % interval.
    too_small
        Cases left out because their fresh excess is lost in the noise; `failed` those that could not be computed;
        `unpredicted` those in which a cause is claimed without a predicted share.
    """

    differences: Mapping[str, float]
    covered: Share
    too_small: int
    failed: int
    unpredicted: int

    @property
    def predicted(self) -> int:
        """How many cases have a predicted share."""
        return self.covered.of + self.too_small + self.failed

    @property
    def median_difference(self) -> float | None:
        """Median of the absolute differences."""
        return median(map(abs, self.differences.values())) if self.differences else None

    def to_json(self) -> dict[str, Any]:
        """Return the fields JSON-ready."""
        return {
            "median_difference": self.median_difference,
            "covered_by_ci90": self.covered.to_json(),
            "differences": dict(self.differences),
            "excess_too_small": self.too_small,
            "not_computed": self.failed,
            "not_predicted": self.unpredicted,
        }


@dataclass(frozen=True, slots=True)
class Scores:
    """Figures of a check, of one program.

    Attributes
    ----------
    kinds : kind -> count
        How many cases of each kind there are; kinds without any are left out.
    named : strength -> share
        Single hidden effects that a set of at most two claimed causes holds at their site.
    sites
        Hidden effects, also those of pairs, named at their site, of those named at any site.
    pairs : strength -> share
        Two hidden effects of which both were named; `pairs_in_part` those of which one was.
    parameters
        Parameters far off that were named.
    set_sizes : size -> count
        Of all claimed causes with their rivals.
    controls_blamed
        Controls in which a cause was claimed, of those that were answered; `controls_with_gap` those in which a gap
        was reported without a cause.
    outside : strength -> share
        Of those outside of the library: no cause was claimed that closes less than half of the gap, or the rest was
        told as unexplained. `outside_from_half`: of those of at least half a unit.
    rest_told
        Of those outside of the library of at least half a unit: the rest was told as unexplained.
    false_causes
        Claimed causes that are none, in all cases that were answered; see `Judged`.
    calibration
        Stated confidence of every claimed cause against whether it, or its first rival, was a true one, site included.
    shares
        Predicted and true shares of the excess that the causes remove.
    sizes_covered
        Sizes of claimed causes that are true ones: how many are within their 95 % interval.
    by_data : kind of data -> share
        Cases that came out right, by repeats, noise and what differs by trial.
    processor_s : "median", "longest" -> seconds
    unanswered : case -> reason
    """

    cases: int
    kinds: Mapping[str, int]
    named: ByStrength
    sites: Share
    pairs: ByStrength
    pairs_in_part: int
    parameters: Share
    set_sizes: Mapping[int, int]
    controls_blamed: Share
    controls_with_gap: Share
    outside: ByStrength
    outside_from_half: Share
    rest_told: Share
    false_causes: int
    calibration: Reliability
    shares: ShareScore
    sizes_covered: Share
    by_data: ByStrength
    processor_s: Mapping[str, float]
    unanswered: Mapping[str, str]

    @property
    def false_causes_per_case(self) -> float | None:
        """Mean number of false causes of the cases that were answered; None if none was."""
        answered = self.cases - len(self.unanswered)
        return self.false_causes / answered if answered else None

    def to_json(self) -> dict[str, Any]:
        """Return the fields JSON-ready."""
        return {
            "cases": self.cases,
            "kinds": dict(self.kinds),
            "named": _shares(self.named),
            "site_right": self.sites.to_json(),
            "pairs_named": _shares(self.pairs),
            "pairs_named_in_part": self.pairs_in_part,
            "parameter_named": self.parameters.to_json(),
            "set_sizes": {str(size): count for size, count in self.set_sizes.items()},
            "controls_blamed": self.controls_blamed.to_json(),
            "controls_with_gap": self.controls_with_gap.to_json(),
            "outside": {
                "right": _shares(self.outside),
                "right_from_0.5": self.outside_from_half.to_json(),
                "rest_told_from_0.5": self.rest_told.to_json(),
            },
            "false_causes": self.false_causes,
            "false_causes_per_case": self.false_causes_per_case,
            "calibration": self.calibration.to_json(),
            "shares": self.shares.to_json(),
            "sizes_covered_by_ci95": self.sizes_covered.to_json(),
            "by_data": _shares(self.by_data),
            "processor_s": dict(self.processor_s),
            "no_answer": dict(self.unanswered),
        }


def score(judged: Sequence[Judged]) -> Scores:
    """Score cases that were judged one by one."""
    of_kind = {kind: [case for case in judged if case.truth.kind == kind] for kind in KINDS}
    singles, pairs, outside = of_kind["effect"], of_kind["pair"], of_kind["outside"]
    # A case without an answer had no occasion for a false cause: it must not make them look rarer.
    answered = [case for case in judged if case.reply.answer is not None]
    controls = [case for case in answered if case.truth.kind == "control"]
    plainly_outside = [case for case in outside if case.truth.strength != STRENGTHS[0]]
    claimed = [(cause, case.truth) for case in judged for cause in case.causes]
    return Scores(
        cases=len(judged),
        kinds={kind: len(cases) for kind, cases in of_kind.items() if cases},
        named=_by_strength(singles, lambda case: case.outcome == "named"),
        sites=Share(
            sum(case.named for case in (*singles, *pairs)), sum(case.effects for case in (*singles, *pairs))
        ),
        pairs=_by_strength(pairs, lambda case: case.outcome == "both-named"),
        pairs_in_part=sum(case.outcome == "one-named" for case in pairs),
        parameters=Share.among(case.outcome == "named" for case in of_kind["parameter"]),
        set_sizes=dict(sorted(Counter(len(cause.members) for cause, _ in claimed).items())),
        controls_blamed=Share.among(case.outcome == "false-alarm" for case in controls),
        controls_with_gap=Share.among(case.outcome == "gap-reported" for case in controls),
        outside=_by_strength(outside, _is_right_outside),
        outside_from_half=Share.among(map(_is_right_outside, plainly_outside)),
        rest_told=Share.among(case.outcome == "rest-told" for case in plainly_outside),
        false_causes=sum(case.false_causes for case in answered),
        calibration=reliability(
            [
                (cause.confidence, is_held(cause, truth))
                for cause, truth in claimed
                if cause.confidence is not None
            ]
        ),
        shares=share_score(judged),
        sizes_covered=Share.among(inside for case in judged for inside in sizes_held(case)),
        by_data={
            data: Share.among(case.right for case in judged if data in case.truth.data)
            for data in sorted({data for case in judged for data in case.truth.data})
        },
        processor_s=_durations([case.reply.processor_s for case in answered]),
        unanswered={case.truth.case: case.reply.reason for case in judged if case.reply.answer is None},
    )


def share_score(judged: Sequence[Judged]) -> ShareScore:
    """Compare predicted and true shares of all cases in which a cause is claimed."""
    differences: dict[str, float] = {}
    covered: list[bool] = []
    too_small = failed = unpredicted = 0
    for case in judged:
        predicted, shown = case.reply.predicted, case.shown
        if not case.causes:
            continue
        if predicted is None:
            unpredicted += 1
        elif shown is None or shown.value is None:
            failed += 1
        elif not shown.counted:
            too_small += 1
        else:
            differences[case.truth.case] = predicted.value - shown.value
            covered.append(predicted.low <= shown.value <= predicted.high)
    return ShareScore(differences, Share.among(covered), too_small, failed, unpredicted)


def reliability(stated: Sequence[tuple[float, bool]]) -> Reliability:
    """Sort (confidence, was right) into tenths. Raises ValueError: a confidence outside of 0 to 1."""
    sorted_in: list[list[tuple[float, bool]]] = [[] for _ in range(_TENTHS)]
    for confidence, right in stated:
        if not 0.0 <= confidence <= 1.0:
            raise ValueError(f"a confidence of {confidence} is not a probability")
        sorted_in[min(int(confidence * _TENTHS), _TENTHS - 1)].append((confidence, right))
    return Reliability(
        tuple(
            Bin(
                index / _TENTHS,
                (index + 1) / _TENTHS,
                sum(confidence for confidence, _ in members) / len(members),
                Share.among(right for _, right in members),
                _by_chance([confidence for confidence, _ in members]),
            )
            for index, members in enumerate(sorted_in)
            if members
        )
    )


def _is_right_outside(case: Judged) -> bool:
    return case.outcome in ("rest-told", "not-blamed")


def _by_strength(judged: Sequence[Judged], hit: Callable[[Judged], bool]) -> dict[str, Share]:
    return {
        strength: Share.among(hit(case) for case in judged if case.truth.strength == strength)
        for strength in STRENGTHS
    }


def _durations(seconds: Sequence[float]) -> dict[str, float]:
    return {"median": median(seconds), "longest": max(seconds)} if seconds else {}


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
