"""Objectives: from the signals of a trial to a number."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.devices import Trajectory
from labrun.errors import ExperimentError, SpecError
from labrun.experiment import ObjectiveTable
from labrun.objectives import Signal, TrialSignals, make_objective
from labrun.objectives.channel import Amplitude, CycleMean, Direction, Mean, Peak, Rms


def trial(time_s, *, period_s=None, discard_cycles=0, end_s=None, unit="N m", **values):
    signals = {f"wrench.{name}": Signal(time_s, np.asarray(column), unit) for name, column in values.items()}
    command = Trajectory(("tail",), np.array([0.0, 1.0]), np.zeros((2, 1)), period_s)
    return TrialSignals(signals, command, 0.0, end_s or float(time_s[-1]), period_s, discard_cycles)


@settings(max_examples=30)
@given(
    st.floats(-3, 3),
    st.floats(0.1, 5),
    st.floats(0.3, 3),
    st.integers(1, 6),
    st.integers(0, 3),
    st.floats(0, 0.99),
)
def test_a_cycle_mean_is_the_mean_over_whole_cycles_whatever_the_oscillation(
    mean, size, f, cycles, discard, rest
):
    end = (discard + cycles + rest) / f
    t = np.arange(0, end + 0.002, 0.002)
    signals = trial(
        t, x=mean + size * np.sin(2 * np.pi * f * t + 0.4), period_s=1 / f, discard_cycles=discard, end_s=end
    )
    assert CycleMean("wrench.x", {})(signals) == pytest.approx(mean, abs=1e-4 * size * (1 + f))


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_lost_samples_do_not_shift_the_cycle_mean(seed):
    t = np.linspace(0, 4, 2001)
    force = 1 + 3 * np.sin(2 * np.pi * t)
    whole = CycleMean("wrench.x", {})(trial(t, x=force, period_s=1.0, discard_cycles=1))
    # A burst in the upper half of one cycle is lost: a plain mean would come out too low.
    start = 1.05 + np.random.default_rng(seed).uniform(0, 0.2)
    kept = (t < start) | (t > start + 0.05)
    assert CycleMean("wrench.x", {})(
        trial(t[kept], x=force[kept], period_s=1.0, discard_cycles=1)
    ) == pytest.approx(whole, abs=1e-2)


def test_what_comes_before_the_cycles_that_count_does_not_matter():
    t = np.linspace(0, 3, 301)
    force = np.where(t < 1, 100.0, 2.0)
    assert CycleMean("wrench.x", {})(trial(t, x=force, period_s=1.0, discard_cycles=1)) == pytest.approx(
        2.0, abs=1e-9
    )


def test_a_torque_at_the_end_of_a_bar_becomes_a_force():
    t = np.linspace(0, 2, 201)
    objective = CycleMean("wrench.x", {"divide_by_m": 0.4, "scale": -1})
    assert objective(trial(t, x=np.full(201, 0.2), period_s=1.0)) == pytest.approx(-0.5)
    assert objective.unit("N m") == "N"
    assert CycleMean("wrench.x", {}).unit("N m") == "N m"


def test_without_a_cycle_there_is_no_cycle_mean():
    with pytest.raises(ExperimentError, match="needs a gait with a cycle"):
        CycleMean("wrench.x", {})(trial(np.linspace(0, 1, 11), x=np.zeros(11)))


def test_a_recording_too_short_for_a_cycle_is_told():
    with pytest.raises(ExperimentError, match="no whole cycle"):
        CycleMean("wrench.x", {})(
            trial(np.linspace(0, 1.5, 11), x=np.zeros(11), period_s=1.0, discard_cycles=1)
        )


def test_a_channel_that_was_not_recorded_comes_with_those_that_were():
    with pytest.raises(ExperimentError, match=r'no channel "wrench\.y".*\n.*wrench\.x'):
        Mean("wrench.y", {})(trial(np.linspace(0, 1, 11), x=np.zeros(11)))


def test_values_that_are_not_numbers_are_an_error_and_no_number():
    values = np.ones(11)
    values[4] = np.nan
    with pytest.raises(ExperimentError, match="not numbers"):
        Mean("wrench.x", {})(trial(np.linspace(0, 1, 11), x=values))


def test_rms_peak_and_amplitude_of_a_sine_are_those_of_a_sine():
    t = np.linspace(0, 2, 4001)
    x = 0.5 - 2 * np.cos(2 * np.pi * t)
    assert Rms("wrench.x", {})(trial(t, x=x, period_s=1.0)) == pytest.approx(np.sqrt(0.25 + 2), rel=1e-6)
    assert Peak("wrench.x", {})(trial(t, x=x, period_s=1.0)) == pytest.approx(2.5, rel=1e-6)
    assert Peak("wrench.x", {"scale": -1})(trial(t, x=x, period_s=1.0)) == pytest.approx(-2.5, rel=1e-6)
    assert Amplitude("wrench.x", {})(trial(t, x=x, period_s=1.0)) == pytest.approx(2, rel=1e-6)
    assert Amplitude("wrench.x", {})(trial(t, x=x)) == pytest.approx(2, rel=1e-6)


def test_noise_does_not_enlarge_the_amplitude_at_the_gaits_frequency():
    t = np.linspace(0, 20, 20001)
    x = np.sin(2 * np.pi * t) + np.random.default_rng(0).normal(0, 1, len(t))
    assert Amplitude("wrench.x", {})(trial(t, x=x, period_s=1.0)) == pytest.approx(1, abs=0.05)
    assert Amplitude("wrench.x", {})(trial(t, x=x)) > 3


@settings(max_examples=30)
@given(st.floats(-179, 179), st.floats(0.1, 10))
def test_direction_is_the_angle_of_the_force_vector(angle, size):
    t = np.linspace(0, 1, 11)
    x, y = size * np.cos(np.radians(angle)), size * np.sin(np.radians(angle))
    signals = trial(t, x=np.full(11, x), y=np.full(11, -y))
    objective = Direction("wrench.x", {"side_channel": "wrench.y", "side_scale": -1})
    assert objective(signals) == pytest.approx(angle)
    assert objective.unit("N") == "deg"


def test_no_force_has_no_direction():
    with pytest.raises(ExperimentError, match="no direction"):
        Direction("wrench.x", {"side_channel": "wrench.y"})(
            trial(np.linspace(0, 1, 11), x=np.zeros(11), y=np.zeros(11))
        )


def test_keys_are_checked_when_the_objective_is_made():
    with pytest.raises(SpecError, match='"channel" is missing'):
        Mean(None, {})
    with pytest.raises(SpecError, match="wrong unit mm: divide_by is given in m"):
        Mean("wrench.x", {"divide_by_mm": 400})
    table = ObjectiveTable.model_validate(
        {"plugin": "labrun.objectives.channel:Mean", "channel": "wrench.x", "scael": 2}
    )
    with pytest.raises(SpecError, match=r'objective thrust: scael: unknown key; did you mean "scale"\?'):
        make_objective("thrust", table)
