"""Numbers, units, conditions and diagnoses in words."""

import math

import pytest

from labrun.estimate import significant
from labrun.gap import Name, ResampledNumber
from labrun.report.gap_words import bound_words
from labrun.report.text import decimal_text, decimals_for, duration_text, label, share_text


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (8000.0, 2, "8000"),
        (44475.5, 2, "44000"),
        (-180.0, 2, "-180"),
        (0.01234, 2, "0.012"),
        (1.0, 2, "1"),
        (0.0, 2, "0"),
        (3.2e9, 2, "3.2e+09"),
        (1.5e-6, 2, "1.5e-06"),
        (math.inf, 2, "inf"),
    ],
)
def test_numbers_of_usual_size_have_no_exponent(value, digits, text):
    assert significant(value, digits) == text


def test_a_least_level_is_told_as_such_to_either_side():
    bounds = {
        "upper": ResampledNumber(1.27, 1.27, 1.74, "rad"),
        "lower": ResampledNumber(-1.27, -1.74, -1.27, "rad"),
        "level": ResampledNumber(0.0486, 0.0486, 0.0747, "N m"),
    }
    assert bound_words(bounds) == [
        "upper at least 1.3 rad",
        "lower at most -1.3 rad",
        "level at least 0.049 N m",
    ]


def test_a_largest_size_is_told_as_such():
    assert bound_words({"time": ResampledNumber(8e-3, 0.0, 8e-3, "s")}) == ["time at most 0.008 s"]
    assert bound_words({"force": ResampledNumber(0.0, 0.0, 0.0, "N")}) == ["force at most 0 N"]


def test_an_effect_that_depends_on_something_is_hyphenated():
    assert Name("load-dependent-friction", "hinge").words == "load-dependent friction at hinge"
    assert Name("reynolds-dependent-drag", "fin").words == "Reynolds-dependent drag at fin"
    assert Name("coulomb-friction", "hinge").words == "Coulomb friction at hinge"


def test_a_column_of_means_has_two_digits_of_its_typical_error():
    decimals = decimals_for([0.0021, 0.0038, None, 0.0009])
    assert decimal_text(0.51873, decimals) == "0.5187"
    assert decimal_text(-0.000001, decimals) == "-1e-06"
    assert decimals_for([None, 0.0]) is None


@pytest.mark.parametrize(("part", "text"), [(0, "0 %"), (0.0123, "0.012 %"), (4.56, "4.6 %"), (62.1, "62 %")])
def test_a_small_share_is_not_rounded_to_nothing(part, text):
    assert share_text(part, 100) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(3.4, "3 s"), (59.7, "1 min 00 s"), (200, "3 min 20 s"), (18420, "5 h 07 min"), (187200, "2 d 4 h")],
)
def test_durations_read_as_people_say_them(seconds, text):
    assert duration_text(seconds) == text


def test_axis_labels_carry_units_from_the_file_or_from_the_name():
    assert label("f", {"f": "Hz"}) == "f (Hz)"
    assert label("angle_deg", {}) == "angle (deg)"
    assert label("history_s", {"history_s": "s"}) == "history (s)"
    assert label("wait_s", {"wait_s": "ms"}) == "wait s (ms)"
    assert label("release", {}) == "release"
