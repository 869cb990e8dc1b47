"""The winch against its emulator in another process, and in front of a bench with a carriage."""

import math

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.carriage_reset.driver import CarriageReset

from labrun.devices import Carriage
from labrun.errors import DeviceError, LimitExceededError

KEYS = {
    "port": "/dev/ttyACM1",
    "limits": {"travel_m": [0.0, 0.8], "speed_m_s": 0.4},
    "start_us": 2000,
    "end_us": 1000,
    "top_speed_m_s": 0.5,
    "hold_s": 1.0,
    "watchdog_ms": 500,
}


@pytest.fixture(scope="module")
def shared():
    with emulated("carriage-reset", KEYS, name="winch") as bench:
        yield bench


@pytest.fixture
def bench(shared):
    shared.driver.open()
    yield shared
    shared.driver.safe_stop()
    shared.driver.close()


def _pulses(bench, after_s):
    return [x["pulses_us"][0] for x in bench.events("command") if x["time_s"] >= after_s]


def test_it_is_a_carriage_and_opening_moves_nothing(bench):
    assert isinstance(bench.driver, Carriage)
    assert bench.driver.travel_m == (0.0, 0.8)
    assert bench.driver.position_m() == pytest.approx(0.8)  # it counts as paid out
    assert bench.driver.health().ok
    assert not bench.events("command")


def test_it_says_what_it_is(bench):
    identity = bench.driver.identify()
    assert identity.firmware == "labreset 1.0"
    assert identity.details["line"] == "0 m at 2000 us, 1 m at 1000 us"
    assert "none" in identity.details["feedback"]
    assert {remark.verdict for remark in bench.driver.examine()} == {"ok"}


def test_a_pull_to_the_start_winds_holds_and_pays_the_line_out_again(bench):
    begun_s = bench.clock.now()
    bench.driver.travel(0.7, 0.4)
    bench.wait_until(lambda: bench.driver.position_m() == pytest.approx(0.7))
    pulled_s = bench.clock.now()
    bench.driver.travel(0.5, 0.4)
    bench.wait_until(lambda: bench.driver.position_m() == pytest.approx(0.5))
    assert bench.clock.now() - pulled_s >= 0.45  # 0.2 m at 0.4 m/s
    pulled_s = bench.clock.now()
    bench.driver.travel(0.0, 0.4)
    bench.wait_until(lambda: bench.driver.position_m() == 0.0)
    arrived_s = bench.clock.now()
    assert arrived_s - pulled_s >= 1.2
    bench.wait_until(lambda: bench.driver.position_m() == pytest.approx(0.8), within_s=8.0)
    assert bench.clock.now() - arrived_s >= 1.0 + 0.8 / 0.4 - 0.2
    sent = _pulses(bench, begun_s)
    assert min(sent) == 1200  # 0.8 m
    assert max(sent) == 2000  # the start
    assert (
        np.abs(np.diff(sent)).max() <= 0.4 * 1000 * 0.02 * 3
    )  # no jump, but for a set-point or two that came late


@pytest.mark.parametrize(
    ("to_m", "speed_m_s", "message"),
    [
        (0.9, 0.1, "travel 0.9 m is above the limit of 0.8 m"),
        (-0.1, 0.1, "below the limit"),
        (0.5, 0.45, "above the limit of 0.4 m/s"),
        (0.5, 0.0, "the speed must be above zero"),
        (math.nan, 0.1, "cannot travel"),
        (0.5, math.inf, "cannot travel"),
    ],
)
def test_a_move_beyond_its_limits_is_not_sent(bench, to_m, speed_m_s, message):
    begun_s = bench.clock.now()
    with pytest.raises(DeviceError, match=f"device winch: .*{message}"):
        bench.driver.travel(to_m, speed_m_s)
    bench.driver.health()
    assert not _pulses(bench, begun_s)


def test_a_set_point_beyond_its_limits_is_not_sent(bench):
    begun_s = bench.clock.now()
    for line_m in (0.81, -0.01, math.nan):
        with pytest.raises(LimitExceededError, match="it was not sent"):
            bench.driver._board.send(np.array([line_m]))
    assert not _pulses(bench, begun_s)


def test_a_stop_reaches_the_winch_within_100_ms_and_holds_it(bench):
    bench.driver.travel(0.1, 0.4)
    bench.wait_until(lambda: bench.driver.pacing().sent > 10)
    asked_s = bench.clock.now()
    bench.driver.safe_stop()
    stop = bench.wait_for("stop", after_s=asked_s)
    assert stop["time_s"] - asked_s < 0.1
    bench.clock.sleep(0.3)
    assert not _pulses(bench, stop["time_s"])
    held_m = (2000 - stop["pulses_us"][0]) / 1000
    assert bench.driver.position_m() == pytest.approx(held_m)
    assert 0.1 < held_m < 0.8


def test_an_emergency_stop_connects_from_scratch(shared):
    asked_s = shared.clock.now()
    CarriageReset.emergency_stop("winch", shared.driver._settings)
    assert shared.wait_for("stop", after_s=asked_s)["time_s"] - asked_s < 0.5


def test_a_probe_tells_the_winch_from_the_fins(shared):
    port = str(shared.bench.settings["winch"]["port"])
    probe = CarriageReset.probe(port)
    assert probe is not None
    assert probe.model == "labreset"


@pytest.mark.parametrize(
    ("fault", "value", "message"),
    [
        ("silence", True, "does not answer"),
        ("watchdog", True, "its watchdog has expired"),
        ("restart", True, "restarted by itself"),
        ("error", "HW,SUPPLY", "hardware is at fault"),
        ("overcurrent", 1, "OVERCURRENT"),
        ("unplug", True, "unplugged"),
    ],
)
def test_a_fault_in_the_midst_of_a_pull_is_told_and_mended(shared, fault, value, message):
    shared.driver.open()
    shared.driver.travel(0.0, 0.1)
    shared.wait_until(lambda: shared.driver.pacing().sent > 5)
    shared.inject(fault, value)
    results = []

    def look():
        try:
            shared.driver.position_m()
            shared.driver.health()
        except DeviceError as error:
            results.append(error)
        return results

    shared.wait_until(look, 3.0)
    assert str(results[0]).startswith("device winch: ")
    assert message in str(results[0])
    shared.driver.safe_stop()
    shared.driver.close()
    if fault == "overcurrent":
        asked_s = shared.clock.now()
        shared.inject("restart")
        shared.wait_for("booted", after_s=asked_s)
    else:
        shared.clear(fault)
    shared.wait_until(lambda: _opens(shared.driver), 3.0)
    assert shared.driver.health().ok
    shared.driver.close()


def _opens(driver):
    try:
        driver.open()
    except DeviceError:
        return False
    return True


def test_the_line_pulls_the_benchs_carriage_once_it_is_taut():
    with emulated("carriage-reset", KEYS, name="winch", scene="fire-tank") as bench:
        scene = bench.bench.scene
        assert scene is not None

        def carriage_m():
            return float(scene.observe(("position",), np.array([bench.clock.now()]))[0, 0])

        scene.tow(0.0, 0.4, 0.5, bench.clock.now())
        bench.wait_until(lambda: carriage_m() == pytest.approx(0.4, abs=1e-3))
        bench.driver.open()
        begun_s = bench.clock.now()
        bench.driver.travel(0.0, 0.4)
        bench.wait_until(lambda: bench.clock.now() > begun_s + 0.75)
        assert carriage_m() == pytest.approx(
            0.4, abs=1e-3
        )  # the line still has slack: 0.3 m of 0.4 m wound up
        bench.wait_until(lambda: carriage_m() < 0.3, within_s=3.0)
        assert carriage_m() >= bench.driver.position_m() - 0.02  # it is pulled, not ahead of the line
        bench.wait_until(lambda: abs(carriage_m()) < 1e-3, within_s=4.0)
        bench.wait_until(lambda: bench.driver.position_m() > 0.1, within_s=4.0)
        assert carriage_m() == pytest.approx(0.0, abs=1e-3)  # paying out pushes nothing
        bench.driver.close()
