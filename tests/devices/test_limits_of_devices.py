"""Limits are numbers, and what is not a number is never inside them."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from labrun.devices import Channel, Limits

KEYS = ("speed_deg_s", "force_n", "torque_n_m", "temperature_c", "speed_m_s")


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_limit_is_a_finite_number_above_zero(key, value):
    with pytest.raises(ValidationError):
        Limits(**{key: value})


@pytest.mark.parametrize("key", ["angle_deg", "travel_m"])
@pytest.mark.parametrize("pair", [(math.nan, 1.0), (-1.0, math.nan), (-math.inf, 1.0), (0.0, math.inf)])
def test_a_range_has_two_finite_ends(key, pair):
    with pytest.raises(ValidationError):
        Limits(**{key: pair})


def test_a_temperature_no_servo_survives_is_a_slip_of_the_pen():
    with pytest.raises(ValidationError):
        Limits(temperature_c=650.0)
    assert Limits(temperature_c=65.0).temperature_c == 65.0


def test_a_sample_that_is_not_a_number_is_an_excess_even_among_greater_ones():
    values = np.array([[0.0], [math.nan], [7.0]])
    (excess,) = Limits(force_n=5.0).sample_excess((Channel("force_x", "N"),), np.arange(3.0), values)
    assert excess.time_s == 1.0
    assert str(excess) == "force_x is not a number; its limit is -5 N"


@pytest.mark.parametrize(("to_m", "speed_m_s"), [(math.nan, 0.1), (0.5, math.nan)])
def test_a_carriage_move_that_is_not_a_number_is_an_excess(to_m, speed_m_s):
    assert list(Limits(travel_m=(0.0, 1.0), speed_m_s=0.5).travel_excess(to_m, speed_m_s))
