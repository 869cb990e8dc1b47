"""What one signal says at other times than those of its samples."""

import numpy as np
import pytest

from labrun.signals import Signal


def test_between_samples_a_signal_is_straight_and_what_is_no_number_is_left_out():
    signal = Signal(np.array([0.0, 1.0, 2.0, 4.0]), np.array([0.0, np.nan, 4.0, 0.0]), "N")
    assert signal.at(np.array([0.5, 1.0, 2.0, 3.0])).tolist() == [1.0, 2.0, 4.0, 2.0]
    assert signal.known().time_s.tolist() == [0.0, 2.0, 4.0]


def test_before_its_first_and_after_its_last_number_a_signal_stays():
    signal = Signal(np.array([0.0, 1.0, 2.0, 3.0]), np.array([np.nan, 5.0, 7.0, np.nan]), "N")
    assert signal.at(np.array([-1.0, 0.0, 3.0, 9.0])).tolist() == [5.0, 5.0, 7.0, 7.0]


def test_a_signal_without_a_number_has_no_value():
    with pytest.raises(ValueError, match="empty"):
        Signal(np.arange(2.0), np.full(2, np.nan), "N").at(np.zeros(1))
