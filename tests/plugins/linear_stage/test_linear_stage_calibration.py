"""Calibration of the load cell, and what the table of the stage may say."""

import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.linear_stage.settings import Calibration, Line, LinearStageSettings, least_squares
from pydantic import ValidationError

MASSES = [0.0, 0.1, 0.2, 0.5, 1.0]
LINE = {"slope_n_per_count": 4.676e-6, "offset_counts": 21400}


@given(st.floats(1e-7, 1e-4), st.sampled_from([-1.0, 1.0]), st.floats(-1e5, 1e5))
def test_exact_readings_give_the_line_back(slope, sign, offset):
    counts = 9.80665 * np.array(MASSES) / (sign * slope * 100) + offset
    line = least_squares(MASSES, counts.tolist())
    assert line.slope_n_per_count == pytest.approx(sign * slope * 100, rel=1e-9)
    assert line.offset_counts == pytest.approx(offset, rel=1e-6, abs=1e-3)
    assert line.residual_n < 1e-6


def test_the_residual_is_the_scatter_of_the_readings_in_newtons():
    rng = np.random.default_rng(3)
    masses = np.repeat(np.linspace(0, 1, 11), 40)
    counts = 9.80665 * masses / 4.676e-6 + 21400 + 500 * rng.standard_normal(len(masses))
    line = least_squares(masses.tolist(), counts.tolist())
    assert line.residual_n == pytest.approx(500 * 4.676e-6, rel=0.1)
    assert line.slope_n_per_count == pytest.approx(4.676e-6, rel=2e-4)


def test_newtons_and_counts_are_inverse_to_each_other():
    line = Line(-4.676e-6, 21400)
    np.testing.assert_allclose(line.force_n(line.counts([-3.0, 0.0, 5.0])), [-3.0, 0.0, 5.0], atol=1e-12)


@pytest.mark.parametrize(
    ("masses", "counts", "words"),
    [
        (MASSES[:4], [1, 2, 3, 4], "needs 5"),
        ([0, 0, 0, 0.1, 0.1, 0.1], [1, 1, 1, 2, 2, 2], "needs 5"),
        (MASSES, [1, 2, 3, 4], "do not belong together"),
        (MASSES, [100, 100, 100, 100, 100], "do not depend"),
        (MASSES, [5, -5, 4, -4, 5], "do not depend"),
        (MASSES, [0, 1e5, 2e5, 5e5, 8388607], "end of the amplifier's range"),
        ([0, 0.1, 0.2, 0.5, float("nan")], [1, 2, 3, 4, 5], "numbers"),
    ],
)
def test_masses_that_make_no_calibration_are_refused_in_words(masses, counts, words):
    with pytest.raises(ValueError, match=words):
        least_squares(masses, counts)


@given(st.floats(0.1, 20), st.floats(1e-7, 1e-5), st.floats(-1e4, 1e4), st.floats(-1, 1))
def test_counts_within_the_boards_bound_never_exceed_the_force_limit(force_n, slope, offset, share):
    line = Line(slope, offset)
    most = line.most_counts(force_n)
    assert abs(float(line.force_n(share * most))) <= force_n * (1 + 1e-9) or most == 0


def test_a_table_of_masses_and_a_table_of_the_line_say_the_same():
    counts = [21400 + 9.80665 * mass / 4.676e-6 for mass in MASSES]
    listed = Calibration(masses_kg=tuple(MASSES), counts=tuple(counts), date="2026-03-02")
    assert listed.line.slope_n_per_count == pytest.approx(Calibration(**LINE).line.slope_n_per_count)
    assert listed.date == datetime.date(2026, 3, 2)


@pytest.mark.parametrize(
    "table",
    [
        {},
        {**LINE, "masses_kg": MASSES, "counts": [1, 2, 3, 4, 5]},
        {"slope_n_per_count": 0.0},
        {"slope_n_per_count": 1e-6, "offset_counts": 8388607},
        {"masses_kg": MASSES[:3], "counts": [1, 2, 3]},
        {**LINE, "date": "soon"},
        {**LINE, "gain": 128},
    ],
)
def test_a_calibration_that_does_not_hold_is_refused(table):
    with pytest.raises(ValidationError):
        Calibration(**table)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"zero_mm": 70}, "zero_mm = 70 is outside the stroke, 0 ... 60 mm"),
        ({"limits": {"travel_m": [-0.04, 0.0]}}, "leaves the stroke, which about zero_mm"),
        ({"limits": {"force_n": 5}}, "limits.force_n needs a calibration"),
        ({"limits": {"force_n": 0.05}, "calibration": LINE}, "below the offset"),
        (
            {
                "limits": {"angle_deg": [-15, 15], "travel_m": [-0.026, 0.026]},
                "joints": {"a": {"lever_mm": 100}},
            },
            "of travel on this lever, and the stage has",
        ),
        ({"limits": {"speed_deg_s": 6}, "joints": {"a": {"lever_mm": 100}}}, "the stage reaches 10 mm/s"),
        ({"watchdog_ms": 0}, "greater than or equal to 20"),
        ({"rate_hz": 200}, "less than or equal to 80"),
        ({"joints": {"a": {"lever_mm": 10}, "b": {"lever_mm": 10}}}, "at most 1"),
    ],
)
def test_settings_that_do_not_hold_together_are_refused_in_words(keys, words):
    with pytest.raises(ValidationError, match=words):
        LinearStageSettings(port="/dev/null", **keys)


def test_travel_is_counted_from_zero():
    settings = LinearStageSettings(port="/dev/null", stroke_mm=60, zero_mm=25)
    assert settings.travel_m == pytest.approx((-0.025, 0.035))
    narrower = LinearStageSettings(port="/dev/null", limits={"travel_m": [-0.01, 0.02]})
    assert narrower.travel_m == (-0.01, 0.02)
