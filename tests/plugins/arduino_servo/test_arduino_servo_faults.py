"""Bad days: what the driver says, that nothing moves afterwards, and that it goes on once the fault is mended."""

import numpy as np
import pytest
from emulated import emulated

from labrun.devices import SerialPort, Trajectory
from labrun.errors import DeviceError

KEYS = {"port": "/dev/ttyACM0", "limits": {"angle_deg": [-60, 60]}, "watchdog_ms": 500}
WITHIN_S = 3.0


@pytest.fixture(scope="module")
def shared():
    with emulated("arduino-servo", KEYS, name="tail") as bench:
        yield bench


@pytest.fixture
def moving(shared):
    """A driver in the midst of a long motion; afterwards the fault is cleared, and everything must work again."""
    driver = shared.driver
    driver.open()
    time_s = np.arange(0.0, 60.0, 0.02)
    angle = np.radians(40 * np.sin(2 * np.pi * time_s))
    driver.follow(Trajectory(("tail",), time_s, angle[:, None]), shared.clock.now())
    shared.wait_until(lambda: driver.pacing().sent > 5)
    yield shared
    for fault in FAULTS:
        shared.bench.clear("tail", fault)
    shared.clear("late")
    driver.safe_stop()
    driver.close()
    shared.wait_until(lambda: _opens(driver), WITHIN_S)  # answers that were late may still be under way
    begun_s = shared.clock.now()
    driver.follow(Trajectory(("tail",), np.zeros(1), np.zeros((1, 1))), begun_s)
    shared.wait_for("command", after_s=begun_s)
    assert driver.health().ok
    driver.close()


FAULTS = [
    "silence", "late", "fragment", "coalesce", "corrupt", "half-frame", "truncate", "drop", "duplicate", "reorder",
    "unplug", "wrong-id", "stale", "error",
]  # fmt: skip


def _opens(driver):
    try:
        driver.open()
    except DeviceError:
        return False
    return True


def _raised(bench):
    """Return what the driver raises, sooner or later, when the runner looks at it."""
    results = []

    def look():
        try:
            bench.driver.pose()
            bench.driver.health()
        except DeviceError as error:
            results.append(error)
        return results

    bench.wait_until(look, WITHIN_S)
    return results[0]


@pytest.mark.parametrize(
    ("fault", "value", "message", "hint"),
    [
        ("silence", True, "does not answer", "check its cable and power"),
        ("late", 0.8, "does not answer", "check its cable and power"),
        ("corrupt", True, "damaged lines came", "check its cable and power"),
        ("half-frame", True, "does not answer", "check its cable and power"),
        ("wrong-id", True, "does not answer", "check its cable and power"),
        ("error", "HW,SUPPLY", r"hardware is at fault \(SUPPLY\)", "weak supply"),
        ("error", "LIMIT,1", "stopped it", "look at the bench"),
        ("error", "WORD", "does not know SV", "flash the firmware"),
        ("watchdog", True, "its watchdog has expired", "watchdog_ms"),
        ("restart", True, "the board restarted by itself", "look at its supply"),
        ("unplug", True, "unplugged", "check its cable and power"),
    ],
)
def test_a_fault_ends_in_an_error_that_names_the_device_and_what_to_do(moving, fault, value, message, hint):
    moving.inject(fault, value)
    error = _raised(moving)
    assert str(error).startswith("device tail: ")
    with pytest.raises(DeviceError, match=message):
        raise error
    assert hint in str(error.hint)


@pytest.mark.parametrize(
    ("fault", "value"),
    [
        ("fragment", True),
        ("coalesce", 3),
        ("duplicate", 20),
        ("reorder", 3),
        ("corrupt", 1),
        ("half-frame", 1),
        ("truncate", 1),
        ("wrong-id", 1),
        ("stale", 20),
        ("late", 0.06),
    ],
)
def test_what_a_wire_does_now_and_then_is_ridden_out(moving, fault, value):
    moving.inject(fault, value)
    sent = moving.driver.pacing().sent
    moving.wait_until(lambda: moving.driver.pacing().sent > sent + 15)
    moving.driver.pose()
    if fault != "coalesce":  # an answer that is kept back for others to come is none in time
        assert moving.driver.health().ok


def test_lost_answers_are_asked_for_again_and_counted(moving):
    moving.inject("drop", 0.2)
    sent = moving.driver.pacing().sent
    moving.wait_until(lambda: moving.driver.pacing().sent > sent + 60)
    moving.clear("drop")
    moving.wait_until(lambda: any("unanswered" in note for note in moving.driver.health().notes), WITHIN_S)


def test_damaged_lines_are_counted_in_the_health(moving):
    moving.inject("corrupt", 2)
    moving.wait_until(lambda: any("damaged lines" in note for note in moving.driver.health().notes))


def test_over_current_turns_the_outputs_off_and_needs_a_restart(moving):
    moving.inject("overcurrent", 1)
    error = _raised(moving)
    assert "OVERCURRENT" in str(error)
    assert "blocked mechanism" in str(error.hint)
    moving.wait_for("stop")
    moving.driver.safe_stop()
    moving.driver.close()
    asked_s = moving.clock.now()
    moving.inject("restart")
    moving.wait_for("booted", after_s=asked_s)


def test_after_a_restart_no_set_point_reaches_the_board(moving):
    asked_s = moving.clock.now()
    moving.inject("restart")
    booted_s = moving.wait_for("booted", after_s=asked_s)["time_s"]
    _raised(moving)
    moving.clock.sleep(0.2)
    assert not [x for x in moving.events("command") if x["time_s"] > booted_s]


def test_after_the_watchdog_expired_no_set_point_is_carried_out(moving):
    moving.inject("watchdog")
    expired_s = moving.events("watchdog")[-1]["time_s"]
    _raised(moving)
    assert not [x for x in moving.events("command") if x["time_s"] > expired_s]


def test_opening_clears_a_watchdog_that_expired_before(shared):
    shared.driver.open()
    shared.inject("watchdog")
    shared.driver.close()
    shared.driver.open()
    assert shared.driver.health().ok
    shared.driver.close()


def test_a_board_that_is_plugged_in_again_works_again(moving):
    moving.inject("unplug")
    moving.wait_for("unplugged")
    assert "unplugged" in str(_raised(moving))
    moving.driver.safe_stop()  # harmless
    moving.driver.close()
    with pytest.raises(DeviceError, match=r"device tail: cannot find the port"):
        moving.driver.open()
    moving.clear("unplug")
    moving.wait_until(
        lambda: moving.events("plugged")[-1]["time_s"] > moving.events("unplugged")[-1]["time_s"]
    )


def test_another_program_on_the_port_is_named(shared):
    port = str(shared.bench.settings["tail"]["port"])
    other = SerialPort("other", port, 115_200)
    other.open()
    try:
        with pytest.raises(DeviceError, match=r"device tail: another program holds"):
            shared.driver.open()
    finally:
        other.close()
    shared.driver.open()
    shared.driver.close()


def test_a_device_that_is_not_open_says_so(shared):
    for call in (shared.driver.pose, shared.driver.identify, shared.driver.examine):
        with pytest.raises(DeviceError, match="is not open"):
            call()
    assert not shared.driver.health().ok
    shared.driver.safe_stop()
    shared.driver.close()
