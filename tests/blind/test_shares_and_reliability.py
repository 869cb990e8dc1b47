import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from labrun.blind.scoring import Share, reliability


def test_the_interval_of_none_of_two_hundred_is_clopper_and_pearsons() -> None:
    interval = Share(0, 200).ci95
    assert interval is not None
    assert interval[0] == 0.0
    assert interval[1] == pytest.approx(1.0 - 0.025 ** (1 / 200), rel=1e-9)


@given(st.integers(1, 120).flatmap(lambda of: st.tuples(st.integers(0, of), st.just(of))))
def test_beyond_the_interval_what_was_seen_has_a_chance_of_a_fortieth(counts: tuple[int, int]) -> None:
    hits, of = counts
    interval = Share(hits, of).ci95
    assert interval is not None
    low, high = interval
    assert low <= hits / of <= high
    if hits > 0:
        assert binom.sf(hits - 1, of, low) == pytest.approx(0.025, rel=1e-6)
    if hits < of:
        assert binom.cdf(hits, of, high) == pytest.approx(0.025, rel=1e-6)


def test_a_share_of_nothing_is_no_number() -> None:
    assert Share.among([]).to_json() == {"share": None, "hits": 0, "of": 0, "ci95": None}


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1))
def test_every_confidence_falls_into_one_bin_and_the_error_is_a_share(
    stated: list[tuple[float, bool]],
) -> None:
    result = reliability(stated)
    assert sum(calibration_bin.right.of for calibration_bin in result.bins) == len(stated)
    assert result.error is not None
    assert 0.0 <= result.error <= 1.0 + 1e-12
    for calibration_bin in result.bins:
        assert calibration_bin.low - 1e-9 <= calibration_bin.stated <= calibration_bin.high + 1e-9


def test_confidences_that_come_true_as_often_as_they_say_have_no_error() -> None:
    assert reliability([(0.75, True)] * 3 + [(0.75, False)]).error == pytest.approx(0.0)
    assert reliability([(1.0, False)] * 5).error == pytest.approx(1.0)


def test_chance_alone_shows_the_error_that_simulated_hits_show() -> None:
    confidences = [0.93, 0.97, 0.91, 0.95, 0.72, 0.78, 0.55]
    hits = np.random.default_rng(5).random((4000, len(confidences))) < confidences
    simulated = [
        reliability([(confidence, bool(hit)) for confidence, hit in zip(confidences, row, strict=True)]).error
        or 0.0
        for row in hits
    ]
    error_by_chance = reliability([(confidence, True) for confidence in confidences]).error_by_chance
    assert error_by_chance == pytest.approx(np.mean(simulated), abs=0.005)


def test_certainties_leave_nothing_to_chance() -> None:
    assert reliability([(1.0, False), (0.0, True)]).error_by_chance == 0.0
    assert reliability([(0.5, True)]).error_by_chance == pytest.approx(0.5)
    assert reliability([]).error_by_chance is None


def test_a_confidence_beyond_one_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.2 is not a probability"):
        reliability([(1.2, True)])
