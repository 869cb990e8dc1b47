"""A motion that is no motion never leaves the plan."""

import pytest
from paddle_lab import experiment_with

from labrun.errors import PlanError
from labrun.runner import Planner

CONDITION = {"a": 10, "f": 1.0}


@pytest.mark.parametrize(
    ("gait", "why"), [("Lost", "an angle of nan rad for joint tail"), ("Timeless", "its period is nan s")]
)
def test_a_gait_that_is_not_a_number_is_a_plan_error_naming_gait_and_condition(gait, why):
    experiment = experiment_with(gait__plugin=f"bad_gaits:{gait}")
    for check in (
        lambda: Planner(experiment).plan([CONDITION]),
        lambda: Planner(experiment).excess_of(CONDITION),
    ):
        with pytest.raises(PlanError) as caught:
            check()
        text = str(caught.value)
        assert text.startswith(f'a = 10, f = 1: gait "bad_gaits:{gait}" computes no motion: ')
        assert why in text


def test_a_condition_that_is_not_a_number_is_a_plan_error():
    with pytest.raises(PlanError, match="a = nan"):
        Planner(experiment_with()).plan([{"a": float("nan"), "f": 1.0}])


@pytest.mark.parametrize("timeout_s", [0.001, 1.9])
def test_a_watchdog_less_patient_than_a_stop_is_refused(timeout_s):
    from labrun.errors import SpecError

    with pytest.raises(
        SpecError, match=r"rig.watchdog_s = .* is shorter than the 2 s that devices get to stop"
    ):
        Planner(experiment_with(rig__watchdog_s=timeout_s)).plan([CONDITION])


def test_conditions_whose_recording_holds_no_whole_cycle_are_told_before_anything_moves():
    experiment = experiment_with(trial__cycles=None, trial__duration_s=1.5, trial__discard_cycles=0)
    plan = Planner(experiment).plan([{"a": 10, "f": 0.5}, {"a": 10, "f": 1.0}])
    assert plan.notes == (
        "1 of 2 conditions record no whole cycle of the gait that counts, and their trials fail at an objective over "
        "whole cycles; a = 10, f = 0.5: the recording of 1.5 s holds no whole cycle of 2 s after the 0 that are "
        "discarded; give trial.cycles, or a longer trial.duration_s",
    )
