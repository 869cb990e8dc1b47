"""What the driver says, and does, when something is wrong on the bus; every fault through the emulator."""

import sys

import numpy as np
import pytest
import serial
from emulated import emulated

from labrun.devices import DeviceError, Trajectory

JOINTS = {"servo_1": {"id": 1}, "servo_2": {"id": 7}}
SETTINGS = {
    "port": "-",
    "joints": JOINTS,
    "limits": {"angle_deg": [-45, 45]},
    "watchdog_ms": 1000,
    "feedback_hz": 50,
}
GOAL = 116


@pytest.fixture(scope="module")
def shared():
    with emulated("dynamixel", SETTINGS, name="servos", scene="spm-stabiliser") as bench:
        yield bench


@pytest.fixture
def bench(shared):
    shared.driver.open()
    yield shared
    shared.driver.safe_stop()
    shared.driver.close()


def _move(bench, angle_deg=30.0, duration_s=3.0):
    driver = bench.driver
    pose = driver.pose()
    ends = np.array([[pose[joint] for joint in driver.joints], np.radians([angle_deg, angle_deg])])
    driver.follow(Trajectory(driver.joints, np.array([0.0, duration_s]), ends), bench.clock.now() + 0.02)


def _told(bench, ask=None):
    """Return what the driver says once it has noticed."""
    results = []

    def look():
        try:
            (ask or bench.driver.pose)()
        except DeviceError as error:
            results.append(error)
        return results

    bench.wait_until(look)
    return results[0]


def _works_again(bench):
    driver = bench.driver
    driver.safe_stop()
    driver.close()
    driver.open()
    assert driver.health().ok
    _move(bench, 5.0, 0.2)
    bench.wait_until(lambda: abs(driver.pose()["servo_1"] - np.radians(5.0)) < 0.01)


def test_silence_is_told_with_the_joint_and_what_to_look_at(bench):
    _move(bench)
    bench.inject("silence")
    error = _told(bench)
    assert error.device == "servos"
    assert "joint servo_1 (id 1) does not answer at 1000000 bits/s" in str(error)
    assert "check its power supply and plug" in str(error)
    bench.clear("silence")
    _works_again(bench)


def test_silence_of_one_servo_is_told_of_that_one(bench):
    _move(bench)
    bench.inject("silent-servo", 7)
    assert "joint servo_2 (id 7) does not answer" in str(_told(bench))
    with pytest.raises(
        DeviceError, match=r"joint servo_2 \(id 7\) does not answer; what answers .*: id 1 \(XM430-W210\)"
    ):
        bench.driver.open()
    bench.clear("silent-servo")
    _works_again(bench)


def test_silence_in_the_stream_of_measurements_is_told(bench):
    bench.driver.start()
    bench.inject("silence")
    assert "does not answer" in str(_told(bench, bench.driver.read))
    bench.clear("silence")
    _works_again(bench)
    bench.driver.start()
    bench.wait_until(lambda: len(bench.driver.read()))
    bench.driver.stop()


def test_a_port_on_which_nobody_answers_names_the_baud_of_new_servos(bench):
    bench.inject("silence")
    with pytest.raises(
        DeviceError, match=r"nor does any other servo at 1000000 bits/s\n.*a new servo talks at 57600"
    ):
        bench.driver.open()
    bench.clear("silence")
    _works_again(bench)


def test_late_answers_are_not_taken_for_new_ones(bench):
    _move(bench, 30.0, 1.0)
    bench.inject("late", 0.2)
    error = str(_told(bench))
    assert "does not answer" in error or "late" in error
    bench.clear("late")
    bench.clock.sleep(0.3)
    _works_again(bench)


def test_stale_answers_are_passed_over(bench):
    driver = bench.driver
    _move(bench, -30.0, 0.3)
    bench.wait_until(lambda: abs(driver.pose()["servo_1"] + np.radians(30.0)) < 0.01)
    driver._bus.fast = False  # ordinary answers can be old ones
    for _ in range(40):  # old answers to choose from, some of them of another pose
        driver._measurement.take()
        bench.clock.sleep(0.01)
    _move(bench, 30.0, 0.3)
    bench.wait_until(lambda: abs(driver.pose()["servo_1"] - np.radians(30.0)) < 0.01)
    bench.inject("stale", 4)
    for _ in range(10):
        assert driver.pose()["servo_1"] == pytest.approx(np.radians(30.0), abs=0.02)
        bench.clock.sleep(0.04)
    bench.clear("stale")


@pytest.mark.parametrize("fault", ["corrupt", "half-frame", "truncate", "duplicate", "reorder", "drop"])
def test_a_few_bad_answers_are_asked_for_again(bench, fault):
    _move(bench, 10.0, 0.5)
    bench.inject(fault, 0.3 if fault == "drop" else 2)
    for _ in range(6):
        assert np.isfinite(list(bench.driver.pose().values())).all()
        bench.clock.sleep(0.04)
    bench.clear(fault)
    assert bench.driver.health().ok


def test_answers_in_single_bytes_are_put_together(bench):
    bench.inject("fragment")
    assert bench.driver.health().ok
    assert len(bench.driver.pose()) == 2
    bench.clear("fragment")


def test_answers_that_are_always_damaged_are_told_as_such(bench):
    bench.inject("corrupt", 10_000)
    error = str(_told(bench))
    assert "arrive damaged" in error
    assert "check the cable" in error
    bench.clear("corrupt")
    _works_again(bench)


def test_an_answer_from_a_strange_id_is_told(bench):
    bench.driver._bus.fast = False
    bench.inject("wrong-id", 10_000)
    error = str(_told(bench))
    assert "but id 2, 8 does, which no joint of the file has" in error or "but id 2 does" in error
    bench.clear("wrong-id")
    _works_again(bench)


@pytest.mark.parametrize("fast", [True, False])
def test_a_refusal_is_told_with_its_meaning_and_never_taken_for_data(bench, fast):
    bench.driver._bus.fast = fast
    bench.inject("error", 10_000)
    assert "grants no access" in str(_told(bench))
    assert "grants no access" in str(_told(bench, bench.driver.health))
    bench.clear("error")
    _works_again(bench)


def test_an_overheated_servo_is_told_and_restarted_when_it_is_cool_again(bench):
    _move(bench)
    bench.inject("overheat", 86)
    bench.wait_for("shutdown")
    error = str(_told(bench))
    assert "joint servo_1 (id 1) reports a hardware error (overheating) and has shut down" in error
    assert "let it cool down" in error
    health = _told(bench, lambda: _raise_unwell(bench.driver))
    assert "overheating" in str(health)
    bench.driver.close()
    with pytest.raises(DeviceError, match="a restart does not help: overheating"):
        bench.driver.open()
    bench.clear("overheat")
    _works_again(bench)
    assert "restarted, it had shut down: overheating" in bench.driver.identify().details["servo_1.set_up"]


def _raise_unwell(driver):
    health = driver.health()
    if not health.ok:
        raise DeviceError("servos", health.notes[0])


def test_an_overloaded_servo_is_told(bench):
    _move(bench)
    bench.inject("overcurrent")
    assert "overload: more current than it can bear" in str(_told(bench))
    bench.clear("overcurrent")
    _works_again(bench)


def test_servos_stopped_by_their_watchdog_are_told(bench):
    _move(bench, 30.0, 5.0)
    bench.inject("watchdog", 1)
    bench.wait_for("watchdog")
    assert "stopped by its watchdog" in str(_told(bench, lambda: _raise_unwell(bench.driver)))
    _works_again(bench)


def test_an_unplugged_port_is_told_and_comes_back(bench):
    _move(bench)
    bench.inject("unplug")
    error = str(_told(bench))
    assert "was unplugged" in error
    assert "labrun resume" in error
    bench.driver.safe_stop()  # never raises
    with pytest.raises(DeviceError, match="cannot find the port"):
        bench.driver.open()
    unplugged_s = bench.clock.now()
    assert (
        bench.wait_for("watchdog", within_s=3.0)["time_s"] < unplugged_s + 3.0
    )  # the servos stop by themselves
    bench.clear("unplug")
    _works_again(bench)


def test_a_port_held_by_another_program_is_told(bench):
    bench.driver.close()
    held = serial.Serial(bench.driver._settings.port, exclusive=True)
    with held, pytest.raises(DeviceError, match="another program holds"):
        bench.driver.open()
    _works_again(bench)


def test_without_the_vendors_library_the_pip_line_is_told(bench, monkeypatch):
    bench.driver.close()
    for name in [
        name for name in sys.modules if name.startswith("dynamixel_sdk") or name.endswith("dynamixel.sdk")
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "dynamixel_sdk", None)
    with pytest.raises(DeviceError, match=r"pip install 'labrun\[dynamixel\]'"):
        bench.driver.open()


def test_a_pause_longer_than_the_watchdog_is_noticed_before_the_next_set_point(bench):
    driver = bench.driver
    _move(bench, 30.0, 0.3)
    bench.wait_until(lambda: driver.pose()["servo_1"] > 0.5)
    driver._stream.end()
    tripped = bench.wait_for("watchdog", within_s=5.0, after_s=bench.clock.now())
    driver._stream.start()
    driver._stream.follow(
        Trajectory(driver.joints, np.array([0.0, 1.0]), np.zeros((2, 2))), bench.clock.now()
    )
    bench.wait_until(lambda: driver._stream._failure is not None)
    assert "stopped by its watchdog" in str(driver._stream._failure)
    late = [x for x in bench.events("command") if x["time_s"] > tripped["time_s"] and x["address"] == GOAL]
    assert not late
