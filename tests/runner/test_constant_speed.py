"""What counts of a towed trial is the travel at constant speed."""

import numpy as np
import pytest
from paddle_lab import experiment_with

from labrun.errors import PlanError, SpecError
from labrun.experiment import CarriageMove, ObjectiveTable
from labrun.objectives import TrialSignals, make_objective
from labrun.runner import MotionMaker, Planner
from labrun.signals import Signal

MOVE = {"device": "arm", "to_m": 0.65, "speed_m_s": "v", "acceleration_m_s2": 0.5, "margin_s": 0.1}


def towed(**changes):
    experiment = experiment_with()
    trial = experiment.trial.model_copy(
        update={
            "cycles": None,
            "discard_cycles": 0,
            "duration_s": "fit",
            "carriage": CarriageMove.model_validate({**MOVE, **changes}),
        }
    )
    return experiment.model_copy(update={"trial": trial})


def motion(v, **changes):
    return MotionMaker(towed(**changes)).motion({"a": 10, "f": 1.0, "v": v})


def test_a_fitted_recording_ends_where_the_carriage_slows_down_and_counts_from_its_speed_on():
    made = motion(0.1)
    assert made.duration_s == pytest.approx(6.5)
    assert made.counts_from_s == pytest.approx(0.1 / 0.5 + 0.1)
    assert made.excess == ()


def test_a_speed_that_needs_a_longer_way_than_there_is_names_both_and_the_key():
    excess = motion(0.6).excess
    assert len(excess) == 1
    assert excess[0].value == pytest.approx(0.72)
    assert excess[0].bound == pytest.approx(0.65)
    assert "trial.carriage.acceleration_m_s2" in str(excess[0])
    assert motion(0.6, acceleration_m_s2=1.0).excess == ()


def test_a_speed_below_zero_is_no_way_back_but_a_limit_left():
    (excess,) = motion(-0.1).excess
    assert str(excess) == (
        "speed of the carriage (trial.carriage.speed_m_s) -0.1 m/s is below the limit of 0 m/s"
    )


def test_a_carriage_that_stands_still_gives_no_length():
    with pytest.raises(PlanError, match='duration_s = "fit" with a carriage that stands still'):
        motion(0.0)


def test_the_ramp_costs_whole_cycles_of_a_gait():
    time_s = np.linspace(0.0, 6.0, 601)
    ramp = np.where(time_s < 1.2, 100.0, 0.0) + np.sin(2 * np.pi * time_s)
    signals = TrialSignals({"w.x": Signal(time_s, ramp, "N")}, None, 0.0, 6.0, 1.0, 1, counts_from_s=1.3)
    assert signals.window() == pytest.approx((2.0, 6.0))
    mean = make_objective("m", ObjectiveTable(plugin="cycle-mean", channel="w.x"))
    assert mean(signals) == pytest.approx(0.0, abs=1e-12)


def test_ramps_that_a_carriage_cannot_set_are_refused():
    class Screw:
        travel_m = (0.0, 1.0)

        def travel(self, to_m, speed_m_s):
            """Move."""

    planner = Planner(experiment_with())
    planner.rig.carriages["arm"] = Screw()
    planner.rig.limits["arm"] = planner.rig.limits["tail"]
    with pytest.raises(SpecError, match="ramps of its own that cannot be set"):
        Planner(towed(), planner.rig)
