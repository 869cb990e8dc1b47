"""The winch of a dry run, its keys, and its place in the runner."""

import json

import numpy as np
import pytest
from labrun_plugins.carriage_reset.driver import line_motion
from labrun_plugins.carriage_reset.settings import CarriageResetSettings
from labrun_plugins.rigs.fish.scene import FireTank
from pydantic import ValidationError

from labrun import registry
from labrun.devices import Carriage, DeviceContext
from labrun.errors import DeviceError, LimitExceededError


class HandClock:
    poll_s = 0.1

    def __init__(self):
        self.now_s = 10.0

    def now(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += max(0.0, duration_s)


class Rail:
    """A bench that only knows where its carriage was told to go."""

    joints = ()

    def __init__(self, position_m):
        self.signals = {"position": "m"}
        self.position_m = position_m
        self.towed = []

    def observe(self, signals, time_s):
        return np.full((len(time_s), 1), self.position_m)

    def tow(self, from_m, to_m, speed_m_s, start_s):
        self.towed.append((from_m, to_m, speed_m_s, start_s))


def _winch(position_m=0.5, **keys):
    clock, rail = HandClock(), Rail(position_m)
    made = registry.load("labrun.devices", "simulated-carriage-reset")
    settings = made.Settings(port="p", **keys)
    winch = made("winch", settings, DeviceContext(clock, np.random.default_rng(0), rail))
    winch.open()
    return winch, clock, rail


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"start_us": 1500, "end_us": 1505}, "less than 10 us apart"),
        ({"limits": {"travel_m": [0, 2]}}, "reaches beyond the line"),
        ({"hold_s": 0.1}, "greater than or equal to 1"),
        ({"start_us": 400}, "greater than or equal to 500"),
        ({"strok_m": 1}, "strok_m"),
    ],
)
def test_keys_that_do_not_hold_are_named(keys, message):
    with pytest.raises(ValidationError, match=message):
        CarriageResetSettings(port="p", **keys)


def test_lengths_become_pulses_and_back_whichever_way_the_servo_is_mounted():
    for start_us, end_us in ((1000, 2000), (2100, 900)):
        settings = CarriageResetSettings(port="p", stroke_m=0.9, start_us=start_us, end_us=end_us)
        assert settings.exact_pulse_us(0.0) == start_us
        assert settings.exact_pulse_us(0.9) == end_us
        assert settings.line_m(settings.exact_pulse_us(0.3)) == pytest.approx(0.3)
        assert settings.pulse_window_us() == (min(start_us, end_us), max(start_us, end_us))


def test_a_move_has_constant_speed_and_a_pull_to_the_start_is_followed_by_slack():
    settings = CarriageResetSettings(port="p", stroke_m=1.0, top_speed_m_s=0.4, hold_s=2.0)
    away = line_motion(settings, 0.2, 0.7, 0.1)
    assert away.time_s == pytest.approx([0.0, 5.0])
    assert away.angle_rad[:, 0] == pytest.approx([0.2, 0.7])
    reset = line_motion(settings, 0.5, 0.0, 0.1)
    assert reset.time_s == pytest.approx([0.0, 5.0, 7.0, 9.5])
    assert reset.angle_rad[:, 0] == pytest.approx([0.5, 0.0, 0.0, 1.0])
    here = line_motion(settings.model_copy(update={"release": False}), 0.0, 0.0, 0.1)
    assert here.duration_s == 0.0


def test_the_stand_in_pulls_the_carriage_when_the_line_is_taut():
    winch, clock, rail = _winch(0.5)
    assert isinstance(winch, Carriage)
    assert winch.position_m() == 1.0
    winch.travel(0.0, 0.1)
    assert rail.towed == [(0.5, 0.0, 0.1, pytest.approx(15.0))]  # 0.5 m of slack at 0.1 m/s
    clock.sleep(10.0)
    assert winch.position_m() == 0.0
    clock.sleep(60.0)
    assert winch.position_m() == 1.0
    assert len(rail.towed) == 1


def test_the_stand_in_stops_with_its_line_where_it_is():
    winch, clock, rail = _winch(0.9)
    winch.travel(0.0, 0.1)
    clock.sleep(3.0)
    winch.safe_stop()
    clock.sleep(5.0)
    assert winch.position_m() == pytest.approx(0.7)
    assert rail.towed[-1] == (0.9, 0.9, 0.0, 13.0)


def test_the_stand_in_refuses_what_the_driver_refuses():
    winch, _, rail = _winch(limits={"travel_m": [0, 0.8], "speed_m_s": 0.2})
    with pytest.raises(LimitExceededError, match=r"limit of 0\.8 m"):
        winch.travel(0.9, 0.1)
    with pytest.raises(LimitExceededError, match=r"limit of 0\.2 m/s"):
        winch.travel(0.5, 0.25)
    winch, _, rail = _winch()
    with pytest.raises(LimitExceededError, match="its winch can do"):
        winch.travel(0.5, 0.5)
    assert rail.towed == []


def test_the_stand_in_remembers_its_line_for_a_resumed_run():
    winch, clock, _ = _winch()
    winch.travel(0.0, 0.1)
    clock.sleep(4.0)
    stored = json.loads(json.dumps(winch.snapshot()))
    other, later, _ = _winch()
    other.restore(stored)
    later.now_s = clock.now_s
    for _ in range(20):
        assert other.position_m() == winch.position_m()
        clock.sleep(1.0)
        later.sleep(1.0)


def test_a_bench_without_a_carriage_is_named():
    made = registry.load("labrun.devices", "simulated-carriage-reset")
    scene = registry.load("labrun.scenes", "caudal-tank")({}, np.random.default_rng(0))
    winch = made(
        "winch", made.Settings(port="p"), DeviceContext(HandClock(), np.random.default_rng(0), scene)
    )
    with pytest.raises(DeviceError, match="device winch: this bench has no position"):
        winch.open()


def test_the_real_bench_s_carriage_comes_back_to_its_start():
    clock = HandClock()
    scene = FireTank({}, np.random.default_rng(0))
    made = registry.load("labrun.devices", "simulated-carriage-reset")
    winch = made("winch", made.Settings(port="p"), DeviceContext(clock, np.random.default_rng(0), scene))
    winch.open()
    scene.tow(0.0, 0.5, 0.3, clock.now())
    clock.sleep(4.0)

    def carriage_m():
        return float(scene.observe(("position",), np.array([clock.now()]))[0, 0])

    assert carriage_m() == pytest.approx(0.5, abs=1e-3)
    winch.travel(0.0, 0.25)
    clock.sleep(1.9)
    assert carriage_m() == pytest.approx(0.5, abs=1e-3)
    clock.sleep(3.0)
    assert carriage_m() == pytest.approx(0.0, abs=1e-3)
