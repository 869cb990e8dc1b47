"""The theory of tape springs: corrected equations against closed forms and limits, and the beams of the source."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.beam.tape_spring_fit import TapeSpring, shape_functions

import labrun


def of_equal_limit(limit_n_m, **known):
    unit = TapeSpring(1.0, **{**known, "width": "arc"})
    return TapeSpring((limit_n_m / unit.equal_limit_n_m) ** (1 / 3), **known)


def test_the_shape_functions_are_those_with_brackets():
    assert shape_functions(1.0)[0] == pytest.approx(0.9945, abs=5e-5)  # as printed it would be 1.262
    assert shape_functions(5.0)[0] == pytest.approx(0.4037, abs=5e-5)
    assert shape_functions(1e4) == pytest.approx((2e-4, 0.5e-4), rel=1e-6)


@given(st.floats(0.05, 0.6))
def test_narrow_strips_go_over_into_the_series_without_a_step(size):
    first, second = shape_functions(size)
    assert first == pytest.approx(1 - size**4 / 180, abs=2e-5)
    assert second == pytest.approx(size**4 / 180, abs=2e-5)


@given(st.floats(0.1, 0.45), st.floats(1e-4, 1e-3))
def test_a_flat_narrow_strip_bends_like_a_beam(poisson, thickness_m):
    strip = TapeSpring(thickness_m, arc_m=1e-3, theta_rad=1e-6, poisson=poisson)
    curvature = 1e-3
    expected = strip.width_m * strip.rigidity_n_m * curvature * (1 - poisson**2)
    assert strip.torque_n_m(curvature) == pytest.approx(expected, rel=1e-3)


@given(st.floats(0.1, 0.45), st.floats(0.5, 3.1))
def test_the_equal_limit_is_what_the_theory_itself_gives_where_both_curvatures_are_alike(poisson, theta):
    strip = TapeSpring(1e-3, theta_rad=theta, poisson=poisson)
    curved = 1 / strip.radius_m
    wide = TapeSpring(1e-6, theta_rad=theta, poisson=poisson)  # so thin that its edges count for nothing
    assert -wide.torque_n_m(-curved) == pytest.approx(wide.equal_limit_n_m, rel=0.02)
    assert strip.equal_limit_n_m == pytest.approx((1 - poisson) * strip.rigidity_n_m * theta)


@pytest.mark.parametrize(("poisson", "thickness_mm", "opposite"), [(0.3, 0.484, 0.81), (0.35, 0.490, 0.85)])
def test_a_sheet_that_buckles_at_the_measured_equal_limit_snaps_near_the_measured_opposite_one(
    poisson, thickness_mm, opposite
):
    arc = of_equal_limit(0.1, poisson=poisson)
    assert 1e3 * arc.thickness_m == pytest.approx(thickness_mm, abs=5e-4)
    assert arc.opposite_limit_n_m == pytest.approx(opposite, abs=5e-3)
    chord = of_equal_limit(0.1, poisson=poisson, width="chord")
    assert chord.opposite_limit_n_m == pytest.approx(0.22 if poisson == 0.3 else 0.23, abs=5e-3)
    assert abs(arc.opposite_limit_n_m - 0.76) < 0.1 < abs(chord.opposite_limit_n_m - 0.76)


def test_the_maximum_is_one():
    strip = TapeSpring(0.49e-3)
    at = strip.opposite_curvature_per_m
    near = [strip.torque_n_m(at * factor) for factor in (0.98, 1.0, 1.02)]
    assert near[1] == max(near)
    assert strip.torque_n_m(3 * at) < near[1]


def test_a_millimetre_of_polyester_has_the_published_range_of_equal_limits():
    limits = [TapeSpring(1e-3, theta_rad=math.radians(theta)).equal_limit_n_m for theta in (30, 180)]
    assert limits == pytest.approx([0.142, 0.850], abs=5e-4)
    assert np.isnan(TapeSpring(1e-3, theta_rad=math.radians(30)).opposite_limit_n_m)


def test_the_shipped_limits_beside_theory_the_short_beam_is_what_it_cannot_describe(tmp_path):
    comparison = labrun.compare("beam-limits", tolerance="15%", results=tmp_path).comparison
    assert not comparison.within
    by_beam = {(point.condition["beam"], point.channel): point for point in comparison.points}
    assert by_beam["long", "equal_limit"].relative < 0.01
    arc = of_equal_limit(0.1)
    assert by_beam["long", "opposite_limit"].predicted == pytest.approx(arc.opposite_limit_n_m, rel=1e-3)
    assert by_beam["long", "opposite_limit"].relative == pytest.approx(0.122, abs=0.005)
    assert comparison.worst.condition["beam"] == "short"
