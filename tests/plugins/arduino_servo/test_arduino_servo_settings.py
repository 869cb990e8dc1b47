"""Keys of the experiment file, and from angles to pulses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.arduino_servo.servo_board import Status
from labrun_plugins.arduino_servo.settings import ArduinoServoSettings, Joint, Pulses, channels_of
from labrun_plugins.labline.codec import MAX_LINE_BYTES, encode
from pydantic import ValidationError

from labrun.devices import Limits
from labrun.errors import DeviceError, LimitExceededError


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"joints": {"a": {"pin": 3}, "b": {"pin": 3}}}, "joints a and b both have pin 3"),
        ({"joints": {"a": {"pin": 4}}}, r"pin 4 of joint a is not one of the firmware's pins \(3, 5, 6, 9\)"),
        ({"joints": {"a": {"pin": 3}, "b": {}}}, "joint b names no pin, but other joints do"),
        (
            {"joints": {name: {} for name in "abcde"}},
            "5 joints are more than the 4 pins that the firmware drives",
        ),
        ({"pins": [3, 3]}, "names a pin twice"),
        ({"joints": {"a": {"pulse_us": [400, 2000]}}}, "within 500 ... 2500 us"),
        ({"joints": {"a": {"pulse_us": [2000, 1000]}}}, "within 500 ... 2500 us"),
        ({"joints": {"a": {"pulse_us": [500, 1000]}}, "limits": {"angle_deg": [0, 60]}}, "no pulse width"),
        ({"watchdog_ms": 10}, "greater than or equal to 20"),
        ({"watchdog_ms": 0}, "greater than or equal to 20"),
        ({"rate_hz": 100}, "less than or equal to 50"),
        ({"prot": "x"}, "prot"),
    ],
)
def test_keys_that_do_not_hold_are_named(keys, message):
    with pytest.raises(ValidationError, match=message):
        ArduinoServoSettings(port="p", **keys)


def test_joints_get_their_channels_by_pin_or_by_place():
    pins = (3, 5, 6, 9)
    assert channels_of({"a": Joint(pin=9), "b": Joint(pin=3)}, pins) == {"a": 3, "b": 0}
    assert channels_of({"a": Joint(), "b": Joint()}, pins) == {"a": 0, "b": 1}


@given(
    st.floats(-60.0, 60.0),
    st.sampled_from([-1, 1]),
    st.floats(-20.0, 20.0),
    st.floats(5.0, 11.0),
)
def test_pulses_say_the_angle_within_half_a_microsecond(angle_deg, sign, neutral_deg, us_per_deg):
    table = Joint(sign=sign, neutral_deg=neutral_deg, us_per_deg=us_per_deg)
    pulses = Pulses("d", {"tail": table}, {"tail": 0}, Limits(angle_deg=(-60, 60)))
    sent = pulses.of(np.radians([angle_deg]))
    low_us, high_us = pulses.windows_us["tail"]
    assert low_us <= sent["tail"] <= high_us
    assert np.degrees(pulses.angles_rad(pulses.by_channel(sent))["tail"]) == pytest.approx(
        angle_deg, abs=0.51 / us_per_deg
    )


@given(st.one_of(st.floats(60.2, 1e6), st.floats(-1e6, -60.2), st.sampled_from([np.nan, np.inf, -np.inf])))
def test_no_pulse_is_made_of_an_angle_beyond_its_limits(angle_deg):
    pulses = Pulses("d", {"tail": Joint()}, {"tail": 0}, Limits(angle_deg=(-60, 60)))
    with pytest.raises(LimitExceededError, match="it was not sent"):
        pulses.of(np.radians([angle_deg]))


def test_rest_is_as_near_to_zero_as_the_limits_allow():
    pulses = Pulses("d", {"tail": Joint()}, {"tail": 0}, Limits(angle_deg=(10, 60)))
    assert pulses.rest_us() == {"tail": 1600}


FIELD = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="$*,"), max_size=12)


@given(st.lists(st.one_of(FIELD, st.integers().map(str)), max_size=9))
def test_a_status_of_any_fields_is_understood_or_told_as_an_error(fields):
    try:
        status = Status.parse("tail", tuple(fields), 4)
    except DeviceError as error:
        assert "device tail: its status says" in str(error)
    else:
        assert len(status.pulses_us) == 4
        assert len(fields) == 6


def test_set_points_of_twelve_channels_fit_on_a_line():
    assert len(encode(65_535, "SV", *[2500] * 12)) <= MAX_LINE_BYTES
    assert len(encode(65_535, "OK", "ST", 0, *[2500] * 12, 2**32 - 1)) <= MAX_LINE_BYTES
