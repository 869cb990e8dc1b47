"""Two units held against one model: what differs is named, what does not is bounded, and noise is no difference."""

from dataclasses import replace

import numpy as np
import pytest
from swings import DAMPING, MODEL, STIFFNESS, dataset_of, swing

from labrun.errors import RequestError
from labrun.gap import Name, ResampledNumber, UnitComparison, UnitDifference, compare_units
from labrun.models import load_model, parse_model
from labrun.report.gap_text import units_text
from labrun.store import SignalInfo


def unit(seed, repeats=1, duration_s=1.2, **physics):
    rng = np.random.default_rng(seed)
    swings, conditions = [], []
    for release in (0.3, 0.8):
        time_s, angle = swing(release, duration_s=duration_s, rate_hz=120.0, **physics)
        for repeat in range(1, repeats + 1):
            swings.append((time_s, angle + 2e-3 * rng.standard_normal(len(angle))))
            conditions.append(({"release_rad": release}, repeat))
    data = dataset_of(swings)
    trials = [
        replace(trial, condition=condition, repeat=repeat)
        for trial, (condition, repeat) in zip(data.trials, conditions, strict=True)
    ]
    return replace(data, trials=tuple(trials))


def compared(first, second, model=MODEL, **given):
    return compare_units(first, second, parse_model(model, "hinge.toml"), np.random.default_rng(0), **given)


@pytest.fixture(scope="module")
def plain():
    return unit(1)


def friction(torque):
    return lambda _, rate: -torque * np.tanh(rate / 0.02)


def test_a_stiffness_that_differs_is_named_with_its_change_and_the_rest_is_bounded(plain):
    points = compared(plain, unit(2, stiffness=1.1 * STIFFNESS))
    (only,) = points.differing
    assert only.parameter == "stiffness"
    assert only.change.low < 0.1 * STIFFNESS < only.change.high
    assert points.share > 0.95
    same = {
        difference.parameter: difference for difference in points.differences if difference.verdict == "same"
    }
    assert same["damping"].change.low < 0.0 < same["damping"].change.high
    text = units_text(points)
    assert "parameter stiffness differs" in text.splitlines()[0]
    assert "kg m^2" in text


def test_friction_that_one_unit_alone_has_is_named_with_its_unit(plain):
    points = compared(plain, unit(2, extra=friction(1.5e-3)))
    assert {difference.name.effect for difference in points.differing} <= {
        "coulomb-friction",
        "stribeck-friction",
        "presliding-friction",
    }
    assert points.differing[0].first == 0.0
    assert points.differing[0].second == pytest.approx(1.5e-3, rel=0.1)
    assert points.differing[0].change.low < 1.5e-3 < points.differing[0].change.high


@pytest.mark.slow
def test_the_size_of_an_effect_that_the_model_carries_is_compared():
    carried = MODEL + '[[effects]]\neffect = "coulomb-friction"\nsite = "hinge"\nvalues = { torque = 1e-3 }\n'
    first, second = (
        unit(seed, duration_s=2.0, extra=friction(torque)) for seed, torque in ((1, 1e-3), (2, 1.4e-3))
    )
    points = compared(first, second, carried)
    (only,) = points.differing
    assert (only.name.effect, only.parameter) == ("coulomb-friction", "torque")
    assert only.second / only.first == pytest.approx(1.4, rel=0.1)


@pytest.mark.slow
def test_friction_that_both_units_have_and_the_model_lacks_is_compared():
    points = compared(
        unit(1, duration_s=2.0, extra=friction(1e-3)), unit(2, duration_s=2.0, extra=friction(1.5e-3))
    )
    (only,) = points.differing
    assert (only.name.effect, only.parameter) == ("coulomb-friction", "torque")
    assert only.second / only.first == pytest.approx(1.5, rel=0.1)


@pytest.mark.slow
def test_two_recordings_of_one_unit_do_not_differ_without_repeats():
    assert compared(unit(1, duration_s=2.0), unit(3, duration_s=2.0)).differing == ()


def test_two_recordings_of_one_unit_do_not_differ():
    points = compared(unit(1, repeats=3), unit(3, repeats=3))
    assert points.differing == ()
    assert units_text(points).startswith("No parameter or effect differs beyond noise")
    damping = next(difference for difference in points.differences if difference.parameter == "damping")
    assert abs(damping.change.high) < 0.2 * DAMPING


def test_units_recorded_unlike_are_refused(plain):
    other = replace(plain, outputs=(SignalInfo("angle", "deg"),))
    with pytest.raises(RequestError, match="other channels"):
        compare_units(plain, other, load_model("hinge-pendulum"), np.random.default_rng(0))


def test_a_change_that_the_data_leave_wide_open_is_told_in_words():
    change = ResampledNumber(-0.0, -23006.0, 23006.0, "rad")
    level = UnitDifference(Name("saturation", "goal"), "level", 1.258, 1.258, change, "both lack")
    text = units_text(UnitComparison("pan", "wrist", "servo", (6, 3), (level,), None, ()))
    assert "not told by these data" in text
    assert "23006" not in text
