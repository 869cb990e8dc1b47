"""Keys of the file, counts, limits, ticks, and the stand-in that offers the same channels."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.dynamixel.commands import CommandCheck
from labrun_plugins.dynamixel.control_table import MODELS, Scale, hardware_errors
from labrun_plugins.dynamixel.driver import Dynamixel
from labrun_plugins.dynamixel.servos import TickClock
from labrun_plugins.dynamixel.settings import DynamixelSettings, Joint
from labrun_plugins.simulated.dynamixel import SimulatedDynamixel

from labrun.devices import Actuator, DeviceContext, DeviceError, Sensor, Trajectory
from labrun.errors import LimitExceededError

sys.path.insert(0, str(Path(__file__).parents[1] / "simulated"))
from simulated_bench import HandClock, StillScene, sine

COUNT = 2 * np.pi / 4096
angles = st.floats(-179.9, 179.9)


def _settings(**keys):
    return DynamixelSettings(**{"port": "p", "joints": {"tail": {"id": 1}}, **keys})


def _check(**keys):
    settings = _settings(**keys)
    scales = tuple(Scale.of(joint, settings) for joint in settings.joints.values())
    return CommandCheck("servos", settings, scales)


def _line(ends_deg, duration_s=1.0, points=51):
    time_s = np.linspace(0.0, duration_s, points)
    return Trajectory(("tail",), time_s, np.radians(np.linspace(*ends_deg, points))[:, None])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"baud": 123_456}, "one of 9600, 57600"),
        ({"watchdog_ms": 110}, "a multiple of 20"),
        ({"return_delay_us": 3}, "a multiple of 2,"),
        ({"position_gains": [1, 2, 99_999]}, "from 0 to 16383"),
        ({"feedback": ["angle", "angle"]}, "name each once"),
        ({"joints": {"a": {"id": 1}, "b": {"id": 1}}}, "joints a and b both have id 1"),
    ],
)
def test_keys_that_no_servo_could_keep_are_refused(keys, message):
    with pytest.raises(ValueError, match=message):
        _settings(**keys)


@given(angle=angles, sign=st.sampled_from([-1, 1]), neutral=st.floats(-90, 90))
def test_an_angle_comes_back_from_its_count(angle, sign, neutral):
    settings = _settings(operating_mode="extended-position")
    scale = Scale.of(Joint(id=1, sign=sign, neutral_deg=neutral), settings)
    count = scale.count(np.radians(angle))
    assert scale.angle_rad(count) == pytest.approx(np.radians(angle), abs=0.51 * COUNT)


@given(low=st.floats(-170, -1), high=st.floats(1, 170), sign=st.sampled_from([-1, 1]), angle=angles)
def test_no_count_lies_outside_the_limits(low, high, sign, angle):
    scale = Scale.of(Joint(id=1, sign=sign), _settings(limits={"angle_deg": [low, high]}))
    first, last = scale.bounds
    for count in (first, last, scale.count(np.radians(angle))):
        assert low - 1e-6 <= np.degrees(scale.angle_rad(count)) <= high + 1e-6
    assert scale.inside(first - 100) == first


def test_half_a_turn_is_the_last_count():
    scale = Scale.of(Joint(id=1), _settings())
    assert (scale.count(-np.pi), scale.count(0.0), scale.count(np.pi)) == (0, 2048, 4095)


def test_position_mode_covers_one_turn_and_extended_mode_many():
    with pytest.raises(DeviceError, match=r"one turn .*\n.*extended-position"):
        _check().trajectory(_line([0, 200]), ("tail",))
    _check(operating_mode="extended-position").trajectory(_line([0, 200]), ("tail",))
    with pytest.raises(DeviceError, match="one turn"):
        _check(joints={"tail": {"id": 1, "neutral_deg": 30}}).trajectory(_line([0, 160]), ("tail",))


def test_a_motion_that_leads_back_from_a_small_overshoot_begins_at_the_limit():
    check = _check(limits={"angle_deg": [-45, 45]})
    motion = check.trajectory(_line([47, 0]), ("tail",))
    assert np.degrees(motion.angle_rad.max()) == pytest.approx(45.0)
    assert np.degrees(motion.angle_rad[-1, 0]) == pytest.approx(0.0)
    for ends in ([49, 0], [0, 47], [46, 47]):
        with pytest.raises(LimitExceededError, match="nothing was sent"):
            check.trajectory(_line(ends), ("tail",))


def test_set_points_are_checked_against_angle_and_speed_and_must_be_numbers():
    check = _check(limits={"angle_deg": [-45, 45], "speed_deg_s": 100})
    check.set_point(np.radians([10.0]), 1.0)
    check.set_point(np.radians([11.0]), 1.01)
    check.set_point(np.radians([12.0]), 1.0101)  # late by nearly a period: that is no speed
    with pytest.raises(LimitExceededError, match="exceeds 100 deg/s"):
        check.set_point(np.radians([14.0]), 1.02)
    with pytest.raises(LimitExceededError, match="leaves"):
        check.set_point(np.radians([45.1]), 9.0)
    with pytest.raises(LimitExceededError, match="not a number"):
        check.set_point(np.array([np.nan]), 9.0)
    check.forget()
    check.set_point(np.radians([-40.0]), 1.03)


def test_a_motion_just_below_its_speed_limit_passes_however_late_its_set_points_leave():
    """The stream sends what is due, and skips what is overdue by a period: nothing of that is too fast."""
    check = _check(limits={"speed_deg_s": 450})
    rng = np.random.default_rng(4)
    now_s, step = 0.0, 0
    while step < 2000:
        now_s = max(now_s, 0.01 * step) + rng.choice([0.0, 0.0099, 0.0101, 0.03])
        step += int((now_s - 0.01 * step) / 0.01)
        check.set_point(np.radians([4.49 * step]), now_s)
        step += 1


def test_ticks_go_on_where_the_count_starts_anew_and_lateness_shows():
    clock = TickClock()
    start_s, late = 1000.0, []
    for n in range(500):
        host_s = start_s + 0.1 * n
        device_s, late_s = clock.at(round(1e3 * (0.1 * n + 20.0)) % 32_768, host_s + 0.001)
        assert device_s == pytest.approx(20.0 + 0.1 * n, abs=1e-3)
        late.append(late_s)
    assert max(late) < 2e-3
    _, late_s = clock.at(round(1e3 * (50.0 + 20.0)) % 32_768, start_s + 50.2)
    assert late_s == pytest.approx(0.2, abs=2e-3)


def test_hardware_errors_are_told_bit_by_bit():
    assert hardware_errors(0) == []
    assert hardware_errors(0b100100) == ["overheating", "overload: more current than it can bear for long"]
    assert "bit 6" in hardware_errors(0b1000000)[0]


def test_models_that_measure_load_have_no_current():
    assert MODELS[1020].current_a == 2.69e-3
    assert MODELS[1060].current_a is None
    assert len({model.name for model in MODELS.values()}) == len(MODELS)


@pytest.mark.parametrize("made", [Dynamixel, SimulatedDynamixel])
def test_driver_and_stand_in_are_sensors_only_when_asked_and_offer_the_same_channels(made):
    keys = {"port": "p", "joints": {"tail": {"id": 1}}}
    context = DeviceContext(HandClock(), np.random.default_rng(1), StillScene({}))
    plain = made("servos", made.Settings(**keys), context)
    assert isinstance(plain, Actuator)
    assert not isinstance(plain, Sensor)
    both = made("servos", made.Settings(**keys, feedback_hz=100, feedback=["angle", "load"]), context)
    assert isinstance(both, Actuator)
    assert isinstance(both, Sensor)
    assert [(c.name, c.unit) for c in both.channels] == [("tail_angle", "rad"), ("tail_load", "1")]
    assert both.rate_hz == 100


def test_the_stand_in_measures_what_its_shaft_does():
    clock = HandClock(3.0)
    settings = SimulatedDynamixel.Settings(port="p", joints={"tail": {"id": 1}}, feedback_hz=100)
    servo = SimulatedDynamixel(
        "servo", settings, DeviceContext(clock, np.random.default_rng(1), StillScene({}))
    )
    servo.open()
    servo.start()
    servo.follow(sine("tail", 40, 1.0, 3.0), 3.0)
    clock.sleep(2.5)
    block = servo.read()
    assert len(block) == pytest.approx(250, abs=2)
    time_s = block.host_time_s - 3.0
    shaft = servo._motion["tail"][1]
    assert np.abs(block.values[:, 0] - shaft.at(time_s)[:, 0]).max() < np.radians(1.0)
    slope = np.gradient(block.values[:, 0], block.device_time_s)
    assert np.median(np.abs(slope - block.values[:, 1])) < 0.1
    assert np.abs(block.values[:, 2]).max() < 0.5
    servo.stop()
    with pytest.raises(DeviceError, match="not streaming"):
        servo.read()
