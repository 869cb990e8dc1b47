import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.gap.where.periods import find_cycle

TIME = np.arange(600) / 100.0


@settings(max_examples=20)
@given(
    frequency=st.floats(0.5, 5.0),
    lag=st.floats(0.0, 1.0),
    harmonic=st.floats(0.0, 0.5),
    offset=st.floats(-9, 9),
)
def test_a_periodic_signal_has_its_period_whatever_its_shape(frequency, lag, harmonic, offset):
    angle = 2 * np.pi * (frequency * TIME - lag)
    signal = offset + np.sin(angle) + harmonic * np.sin(2 * angle)
    cycle = find_cycle(TIME, [signal], {})
    assert cycle.frequency_hz == pytest.approx(frequency, rel=2e-2)


@pytest.mark.parametrize(
    "signal",
    [
        np.random.default_rng(0).standard_normal(600),
        np.sin(2 * np.pi * (0.3 * TIME + 0.5 * TIME**2)),
        np.exp(-1.5 * TIME) * np.sin(2 * np.pi * 2 * TIME),
        (TIME > 3.0).astype(float),
        np.zeros(600),
    ],
    ids=["noise", "chirp", "ring-down", "step", "nothing"],
)
def test_what_does_not_repeat_has_no_cycle(signal):
    assert find_cycle(TIME, [signal], {}) is None


def test_a_stated_period_is_taken_if_a_signal_has_it():
    signal = np.sin(2 * np.pi * 1.25 * TIME)
    assert find_cycle(TIME, [signal], {"frequency_hz": 1.25}).period_s == 0.8
    assert find_cycle(TIME, [signal], {"period_s": 0.8}).period_s == 0.8
    assert find_cycle(TIME, [signal], {"freq": 3.0}).period_s == pytest.approx(0.8, rel=1e-3)


def test_single_samples_have_no_cycle():
    assert find_cycle(np.zeros(1), [np.ones(1)], {"frequency_hz": 1.0}) is None
