"""Averages over beats or one joint's cycles: what a trial's motion knows of them, and what a run stores."""

import numpy as np
import pytest
from paddle_lab import experiment_with

from labrun.errors import PlanError
from labrun.experiment import CyclesOf
from labrun.runner import MotionMaker
from labrun.search import t_interval


def averaged(average, **changes):
    experiment = experiment_with()
    trial = experiment.trial.model_copy(
        update={"cycles": None, "discard_cycles": 0, "duration_s": 6.5, "average": average, **changes}
    )
    return MotionMaker(experiment.model_copy(update={"trial": trial}))


def test_the_motion_tells_the_frequencies_of_the_joints_that_move():
    assert averaged("beats").motion({"a": 10, "f": 0.9}).frequencies_hz == {"tail": 0.9}
    assert averaged("beats").motion({"a": 0, "f": 0.9}).frequencies_hz == {}
    assert averaged(CyclesOf(cycles_of="tail")).motion({"a": 0, "f": 0.9}).frequencies_hz == {"tail": 0.9}
    assert averaged(None).motion({"a": 10, "f": 0.9}).frequencies_hz == {}


def test_a_recording_too_short_for_a_cycle_is_known_before_anything_moves():
    excess = averaged("beats", discard_cycles=1).motion({"a": 10, "f": 0.2}).excess
    assert len(excess) == 1
    assert (excess[0].value, excess[0].bound) == pytest.approx((10.0, 6.5))
    assert "one cycle of tail" in str(excess[0])


def test_a_joint_without_a_frequency_cannot_be_averaged_over():
    with pytest.raises(PlanError, match="gives fin no frequency"):
        averaged(CyclesOf(cycles_of="fin")).motion({"a": 10, "f": 0.9})


def test_what_is_cut_widens_the_interval_however_many_repeats_there_are():
    few, many = (np.random.default_rng(0).normal(1.0, 0.1, count) for count in (4, 4000))
    for values in (few, many):
        plain, wide = t_interval(values), t_interval(values, (), 0.05)
        assert wide == pytest.approx((plain[0] - 0.05, plain[1] + 0.05))
