"""The mean magnitude of a channel."""

import numpy as np
import pytest

from labrun.devices import Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.experiment import ObjectiveTable
from labrun.objectives import TrialSignals, make_objective
from labrun.signals import Signal

TIME_S = np.linspace(0.0, 200.0, 4001)
TRIANGLE = np.where(TIME_S < 100, 0.5, -0.1)


def value(**settings):
    signals = TrialSignals(
        signals={"loop.force_error": Signal(TIME_S, TRIANGLE, "N")},
        command=Trajectory(("tail",), np.zeros(1), np.zeros((1, 1))),
        start_s=0.0,
        end_s=200.0,
        period_s=1 / 1.4,
    )
    table = ObjectiveTable(plugin="mean-absolute", channel="loop.force_error", **settings)
    return make_objective("off", table)(signals)


def test_the_magnitude_is_averaged_over_the_whole_or_a_part():
    assert value() == pytest.approx(0.3, abs=1e-3)
    assert value(to_s=100.0) == pytest.approx(0.5, abs=1e-3)
    assert value(from_s=100.0) == pytest.approx(0.1, abs=1e-3)
    assert value(from_s=50.0, to_s=150.0) == pytest.approx(0.3, abs=1e-3)


def test_scale_and_length_act_on_the_magnitude():
    assert value(scale=-1.0, divide_by_m=0.5, to_s=99.0) == pytest.approx(1.0)
    table = ObjectiveTable(plugin="mean-absolute", channel="loop.force_error", divide_by_m=0.5)
    assert make_objective("off", table).unit("N m") == "N"


def test_a_part_that_holds_nothing_is_an_error():
    with pytest.raises(ExperimentError, match="fewer than 2 samples"):
        value(from_s=300.0, to_s=400.0)
    with pytest.raises(SpecError, match="not after from_s"):
        value(from_s=20.0, to_s=10.0)
