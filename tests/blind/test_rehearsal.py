"""What a hidden effect would show is rehearsed as the run measures it."""

import math
from pathlib import Path

import pytest

from labrun.blind.hiding import conditions_of, named_model
from labrun.blind.rehearsal import Rehearsal
from labrun.experiment import load_named


def rehearsal_of(name: str, *overrides: str) -> Rehearsal:
    loaded = load_named(name, Path(), overrides)
    model = named_model(loaded)
    assert model is not None
    return Rehearsal(loaded.experiment, model, conditions_of(loaded.experiment))


def entry(effect: str, site: str, kind: str, **values: float) -> dict[str, object]:
    return {"effect": effect, "site": site, "kind": kind, "values": values}


@pytest.fixture(scope="module")
def strip() -> Rehearsal:
    return rehearsal_of("polyester-tensile", "run.conditions=[{specimen=1}]")


def test_a_strip_that_is_mounted_anew_is_no_noise(strip):
    # one that has yielded would differ from a new one by more than any effect does
    assert strip.size(entry("bias", "force", "output", offset=2.0)) > 1.0


def test_a_late_cell_is_slack_which_each_strip_has_of_its_own(strip):
    # a shift of 0.07 or 0.27 mm, by far too long for a first step: a real recalibration makes up for it
    late = entry("delay", "force", "output", delay=0.4)
    assert strip.size(late) > 1.0
    assert strip.recalibrated_size(late) < 0.01
    later = entry("delay", "force", "output", delay=1.6)
    assert strip.recalibrated_size(later) < 0.3 * strip.size(later)


def test_what_would_push_the_grip_out_of_its_limits_on_the_way_back_is_too_large(strip):
    # twelve times as fast as the test: a drag that shows in the test is 144 times as large there
    assert strip.size(entry("quadratic-drag", "strip", "joint", coefficient=2e8)) == float("inf")


def test_a_trial_longer_than_a_bench_remembers_is_rehearsed_in_stretches():
    beam = rehearsal_of("beam-buckling", 'run.conditions=[{beam="long",specimen=1,reach=-28.648}]')
    assert beam.size(entry("saturation", "force", "output", level=0.8, knee=0.0)) > 1.0


def test_an_output_is_judged_by_the_signal_that_shows_it():
    # the place of a body on a circle would show a gain that its angle does not
    swing = rehearsal_of("hinge-repeatability", "run.conditions=[{test=1,release=20}]")
    assert swing.size(entry("gain-error", "angle", "output", error=0.05)) < 0.1


def test_stribeck_friction_at_one_speed_far_beyond_its_own_is_coulomb_friction(strip):
    friction = {"torque": 6.0, "transition_speed": 2e-6}
    stribeck = entry(
        "stribeck-friction", "strip", "joint", **friction, static_excess=1.0, stribeck_speed=1.5e-5
    )
    coulomb = entry("coulomb-friction", "strip", "joint", **friction)
    assert strip.recalibrated_size(stribeck) > 1.0
    assert strip.apart(stribeck, coulomb) < 0.1
    assert strip.apart(stribeck, entry("cubic-stiffness", "strip", "joint", coefficient=1e9)) > 1.0


def test_what_would_end_the_run_at_a_limit_of_a_device_is_too_large(strip):
    weaker_cell = rehearsal_of(
        "polyester-tensile", "run.conditions=[{specimen=1}]", "rig.devices.stage.limits.force_n=92"
    )
    bias = entry("bias", "force", "output", offset=20.0)
    assert strip.size(bias) < float("inf")
    assert weaker_cell.size(bias) == float("inf")


@pytest.mark.slow
def test_a_free_carriage_is_brought_back_between_two_trials_and_its_way_is_no_scatter():
    rowing = rehearsal_of("rowing")
    assert 1 < rowing.size(entry("coulomb-friction", "rail", "joint", torque=0.05)) < math.inf
