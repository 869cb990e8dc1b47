"""The driver against its emulator, over a pty."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.dynamixel.commands import emergency_stop
from labrun_plugins.dynamixel.control_table import TORQUE_ENABLE
from labrun_plugins.dynamixel.driver import Dynamixel

from labrun.devices import Actuator, DeviceContext, DeviceError, Sensor, Trajectory
from labrun.errors import LimitExceededError

JOINTS = {"servo_1": {"id": 1}, "servo_2": {"id": 7, "sign": -1, "neutral_deg": 10}}
LIMITS = {"angle_deg": [-45, 45], "speed_deg_s": 400}
SETTINGS = {"port": "-", "joints": JOINTS, "limits": LIMITS, "watchdog_ms": 1000}
COUNT = 2 * np.pi / 4096
GOAL, TORQUE = 116, 64


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


@contextmanager
def _with(shared, **keys):
    """Give the same servos an open driver with other keys."""
    usual = shared.driver
    settings = Dynamixel.Settings.model_validate({**SETTINGS, **shared.bench.settings["servos"], **keys})
    shared.driver = Dynamixel("servos", settings, DeviceContext(shared.clock, np.random.default_rng(1)))
    try:
        shared.driver.open()
        yield shared
    finally:
        shared.driver.safe_stop()
        shared.driver.close()
        shared.driver = usual


@pytest.fixture
def limp(shared):
    """A bench on which a stop takes the torque away."""
    with _with(shared, on_stop="torque-off") as bench:
        yield bench


def _to(driver, angles_deg, duration_s=0.3):
    """Return a straight motion from where the joints are."""
    pose = driver.pose()
    ends = np.array([[pose[joint] for joint in driver.joints], np.radians(angles_deg)])
    return Trajectory(driver.joints, np.array([0.0, duration_s]), ends)


def _go(bench, angles_deg, duration_s=0.3):
    driver = bench.driver
    driver.follow(_to(driver, angles_deg, duration_s), bench.clock.now() + 0.02)
    bench.wait_until(
        lambda: np.allclose(list(driver.pose().values()), np.radians(angles_deg), atol=3 * COUNT)
    )


def _goals(bench, joint, after_s=0.0):
    lines = [x for x in bench.events("command") if x["address"] == GOAL and x["time_s"] > after_s]
    return [line["value"] for line in lines if line["joint"] == joint]


def test_joints_follow_and_say_where_they_are(bench):
    driver = bench.driver
    assert isinstance(driver, Actuator)
    assert not isinstance(driver, Sensor)
    _go(bench, [20.0, -30.0])
    counts = {joint: _goals(bench, joint)[-1] for joint in driver.joints}
    assert counts["servo_1"] == 2048 + round(20 / 360 * 4096)
    assert counts["servo_2"] == 2048 + round(
        (30 + 10) / 360 * 4096
    )  # mounted the other way round, horn 10 deg off
    assert driver.pacing().sent > 20
    driver.restart_pacing()
    assert driver.pacing().sent == 0


def test_the_torque_comes_with_the_first_motion_where_the_joints_are(bench):
    begun_s = bench.clock.now()
    assert not [x for x in bench.events("command") if x["time_s"] > begun_s]
    driver = bench.driver
    pose = driver.pose()
    driver.follow(_to(driver, [5.0, 5.0]), bench.clock.now() + 0.02)
    first = next(x for x in bench.events("command") if x["time_s"] > begun_s and x["joint"] == "servo_1")
    assert first["address"] == GOAL
    assert first["value"] == 2048 + round(pose["servo_1"] / COUNT)


def test_the_set_up_is_written_and_read_back(bench):
    details = bench.driver.identify().details
    assert details["servo_2.id"] == "7"
    assert details["servo_1.model"] == "XM430-W210"
    assert details["servo_1.return_delay_us"] == "0"
    assert bench.driver.identify().firmware == "46"
    text = " ".join(remark.message for remark in bench.driver.examine())
    assert "counts 1536 to 2560" in text  # +-45 deg also in the servo itself
    assert "fast sync read of 2 servos" in text


def test_health_tells_temperature_voltage_and_torque(bench):
    health = bench.driver.health()
    assert health.ok
    assert health.temperature_c == 35.0
    assert any("12.0 V" in note for note in health.notes)


def test_a_motion_beyond_the_limits_is_refused_whole(bench):
    begun_s = bench.clock.now()
    for angles, message in [
        ([50.0, 0.0], "above the limit of 45 deg"),
        ([0.0, -60.0], "below the limit of -45 deg"),
    ]:
        with pytest.raises(LimitExceededError, match=message):
            bench.driver.follow(_to(bench.driver, angles), bench.clock.now())
    with pytest.raises(LimitExceededError, match="speed of servo_1"):
        bench.driver.follow(_to(bench.driver, [40.0, 0.0], 0.02), bench.clock.now())
    with pytest.raises(DeviceError, match="got a motion of servo_1"):
        bench.driver.follow(Trajectory(("servo_1",), np.zeros(1), np.zeros((1, 1))), bench.clock.now())
    assert not [x for x in bench.events("command") if x["time_s"] > begun_s]


def test_a_set_point_beyond_the_limits_is_never_sent_even_if_the_motion_changes_on_the_way(bench):
    driver = bench.driver
    _go(bench, [0.0, 0.0])
    begun_s = bench.clock.now()
    motion = Trajectory(driver.joints, np.linspace(0, 1, 101), np.zeros((101, 2)))
    checked = driver._check.trajectory(motion, driver.joints)
    checked.angle_rad[50:, 0] = np.radians(46.0)
    driver._stream.follow(checked, bench.clock.now())
    bench.wait_until(lambda: driver._stream._failure is not None)
    with pytest.raises(LimitExceededError, match="not sent"):
        driver.pose()
    assert max(_goals(bench, "servo_1", begun_s)) <= 2560


def test_a_set_point_too_far_from_the_last_one_is_never_sent(bench):
    driver = bench.driver
    _go(bench, [0.0, 0.0])
    begun_s = bench.clock.now()
    motion = Trajectory(driver.joints, np.linspace(0, 1, 101), np.zeros((101, 2)))
    motion.angle_rad[50:, 0] = np.radians(40.0)
    driver._stream.follow(motion, bench.clock.now())
    bench.wait_until(lambda: driver._stream._failure is not None)
    with pytest.raises(LimitExceededError, match="exceeds 400 deg/s"):
        driver.health()
    assert max(_goals(bench, "servo_1", begun_s)) == 2048


def test_a_motion_from_rest_that_would_begin_with_a_jump_is_refused(bench):
    driver = bench.driver
    _go(bench, [20.0, 0.0])
    driver.safe_stop()
    begun_s = bench.clock.now()
    away = Trajectory(driver.joints, np.array([0.0, 1.0]), np.radians([[-20.0, 0.0], [0.0, 0.0]]))
    with pytest.raises(
        LimitExceededError, match=r"servo_1 begins at -20\.0 deg, and it stands at (19\.[5-9]|20\.[0-5]) deg"
    ):
        driver.follow(away, bench.clock.now())
    bench.clock.sleep(0.1)
    assert not _goals(bench, "servo_1", begun_s)


def test_a_stop_holds_the_joints_where_they_are_and_nothing_moves_afterwards(bench):
    driver = bench.driver
    _go(bench, [-40.0, 0.0])
    driver.follow(_to(driver, [40.0, 0.0], 2.0), bench.clock.now())
    bench.wait_until(lambda: driver.pose()["servo_1"] > np.radians(-20))
    asked_s = bench.clock.now()
    driver.safe_stop()
    driver.safe_stop()
    stop = bench.wait_for("stop", after_s=asked_s)
    assert stop["how"] == "hold"
    assert (
        stop["time_s"] - asked_s < 0.1
    )  # on its own it takes a few milliseconds; a busy machine may need more
    held = driver.pose()["servo_1"]
    bench.clock.sleep(0.3)
    assert driver.pose()["servo_1"] == pytest.approx(held, abs=np.radians(3))
    assert len(set(_goals(bench, "servo_1", stop["time_s"] + 0.02))) <= 1
    assert bench.driver.health().ok  # still held, and watched
    _go(bench, [0.0, 0.0])


def test_a_stop_gets_through_while_another_thread_talks_all_the_time(bench):
    driver = bench.driver
    _go(bench, [-40.0, 0.0])
    driver.follow(_to(driver, [40.0, 0.0], 2.0), bench.clock.now())
    ending = threading.Event()

    def chat():
        while not ending.is_set():
            driver.pose()
            driver.health()

    thread = threading.Thread(target=chat, daemon=True)
    thread.start()
    bench.clock.sleep(0.3)
    asked_s = bench.clock.now()
    driver.safe_stop()
    took_s = bench.clock.now() - asked_s
    ending.set()
    thread.join(2.0)
    assert bench.wait_for("stop", after_s=asked_s)["time_s"] - asked_s < 0.1 + took_s
    assert len(set(_goals(bench, "servo_1", asked_s + took_s))) <= 1


def test_a_stop_that_comes_in_the_midst_of_a_new_command_wins(bench):
    driver = bench.driver
    _go(bench, [0.0, 0.0])
    begin, begun_s = driver._stream.follow, bench.clock.now()

    def interrupted(*motion):
        driver.safe_stop()
        begin(*motion)

    driver._stream.follow = interrupted
    driver.follow(_to(driver, [30.0, 0.0]), bench.clock.now())
    driver._stream.follow = begin
    bench.clock.sleep(0.4)
    assert abs(driver.pose()["servo_1"]) < 3 * COUNT
    assert max(_goals(bench, "servo_1", begun_s), default=2048) < 2052


def test_a_stop_that_comes_while_the_torque_is_switched_on_takes_it_away_again(limp, monkeypatch):
    driver = limp.driver
    ask = driver._bus.require

    def interrupted(ids, block):
        monkeypatch.setattr(driver._bus, "require", ask)
        driver.safe_stop()
        driver._bus.group_write(TORQUE_ENABLE, dict.fromkeys(ids, 1))  # as if the stop had come just before
        return ask(ids, block)

    monkeypatch.setattr(driver._bus, "require", interrupted)
    begun_s = limp.clock.now()
    driver.follow(_to(driver, [10.0, 0.0]), limp.clock.now())
    torque = [x for x in limp.events("command") if x["address"] == TORQUE and x["time_s"] > begun_s]
    assert {x["joint"]: x["value"] for x in torque} == {"servo_1": 0, "servo_2": 0}  # the last word of each
    assert driver._stream.set_point() is None


def test_joints_keep_their_place_when_the_device_is_closed_and_opened(bench):
    driver = bench.driver
    _go(bench, [25.0, 5.0])
    closed_s = bench.clock.now()
    driver.close()
    driver.close()
    bench.clock.sleep(0.2)
    driver.open()
    assert driver.pose()["servo_1"] == pytest.approx(np.radians(25), abs=3 * COUNT)
    assert not [x for x in bench.events("command") if x["time_s"] > closed_s]
    with pytest.raises(DeviceError, match="is not open"):
        driver.close()
        driver.pose()


def test_a_joint_that_overshot_its_limit_is_led_back(bench):
    driver = bench.driver
    _go(bench, [44.9, 0.0])
    begun_s = bench.clock.now()
    back = Trajectory(driver.joints, np.array([0.0, 0.5]), np.radians([[46.0, 0.0], [0.0, 0.0]]))
    driver.follow(back, bench.clock.now())
    bench.wait_until(lambda: abs(driver.pose()["servo_1"]) < 3 * COUNT)
    assert max(_goals(bench, "servo_1", begun_s)) <= 2560


def test_the_emergency_stop_needs_no_driver(bench):
    driver = bench.driver
    _go(bench, [-40.0, 0.0])
    driver.follow(_to(driver, [40.0, 0.0], 2.0), bench.clock.now())
    bench.clock.sleep(0.3)
    settings = driver._settings
    driver._stream.halt()  # a runner that is dead sends nothing
    driver._stream.end()
    driver._bus.close()
    asked_s = bench.clock.now()
    emergency_stop("servos", settings, bench.clock)
    assert bench.wait_for("stop", after_s=asked_s)["how"] == "hold"


def test_a_probe_finds_them_and_leaves_the_port_free(shared):
    shared.driver.close()
    probe = Dynamixel.probe(shared.driver._settings.port)
    assert probe.model == "Dynamixel XM430-W210"
    assert probe.details["id 7"] == "XM430-W210, firmware 46"
    shared.driver.open()
    assert Dynamixel.probe(shared.driver._settings.port) is None  # held by the driver
    shared.driver.close()


def test_a_dead_runner_is_noticed_by_the_watchdog_of_the_servos(shared):
    with _with(shared, watchdog_ms=200) as bench:
        driver = bench.driver
        driver.follow(_to(driver, [30.0, 0.0], 5.0), bench.clock.now())
        bench.clock.sleep(0.5)
        silent_s = bench.clock.now()
        driver._stream.end()
        last = [x for x in bench.events("command") if x["address"] == GOAL][-1]
        tripped = bench.wait_for("watchdog", after_s=silent_s)
        assert 0.19 < tripped["time_s"] - last["time_s"] < 0.4
        health = driver.health()
        assert not health.ok
        assert "stopped by its watchdog" in health.notes[0]
        emergency_stop_settings = driver._settings
        driver.close()
        emergency_stop(
            "servos", emergency_stop_settings, bench.clock
        )  # what has stopped already is left alone
        driver.open()  # clears it
        assert driver.health().ok
        driver.follow(_to(driver, [0.0, 0.0], 1.0), bench.clock.now())


def test_with_torque_off_a_stop_takes_the_torque_and_the_next_motion_brings_it_back(limp):
    driver = limp.driver
    _go(limp, [20.0, 0.0])
    asked_s = limp.clock.now()
    driver.safe_stop()
    stop = limp.wait_for("stop", after_s=asked_s)
    assert stop["how"] == "torque-off"
    assert stop["time_s"] - asked_s < 0.1
    _go(limp, [0.0, 0.0])
    assert driver.health().ok
    driver.close()
    asked_s = limp.clock.now()
    type(driver).emergency_stop("servos", driver._settings)
    torque = [x["value"] for x in limp.events("command") if x["address"] == TORQUE and x["time_s"] > asked_s]
    assert torque
    assert not any(torque)


def test_with_feedback_it_is_a_sensor_that_agrees_with_what_is_commanded(shared):
    with _with(shared, feedback_hz=50) as bench:
        driver = bench.driver
        _go(bench, [0.0, 0.0])
        assert isinstance(driver, Actuator)
        assert isinstance(driver, Sensor)
        assert [c.name for c in driver.channels][:3] == ["servo_1_angle", "servo_1_speed", "servo_1_current"]
        driver.start()
        driver.restart_pacing()
        time_s = np.linspace(0, 1.2, 121)
        angle = np.radians(20) * np.sin(2 * np.pi * time_s)
        start_s = bench.clock.now() + 0.1
        driver.follow(Trajectory(driver.joints, time_s, np.column_stack([angle, -angle])), start_s)
        bench.clock.sleep(1.4)
        block = driver.read()
        driver.stop()
        assert len(block) + block.lost == pytest.approx(75, abs=15)
        moving = (block.host_time_s > start_s + 0.2) & (block.host_time_s < start_s + 1.1)
        at_s = block.host_time_s[moving] - start_s
        lag = 2 * 0.8 / (2 * np.pi * 15) + 0.005 + 0.002
        wanted = np.radians(20) * np.sin(2 * np.pi * (at_s - lag))
        assert np.median(np.abs(block.values[moving, 0] - wanted)) < np.radians(2)
        assert np.median(np.abs(block.values[moving, 0] + block.values[moving, 3])) < 2 * COUNT
        slope = np.gradient(block.values[:, 0], block.device_time_s)
        assert np.median(np.abs(slope[moving] - block.values[moving, 1])) < 0.4
        assert np.all(np.diff(block.device_time_s) > 0)
        assert driver.pacing().missed < 20
        with pytest.raises(DeviceError, match="not streaming"):
            driver.read()


@pytest.mark.parametrize(
    ("faults", "keys", "message"),
    [
        ({"model": 1060}, {"feedback_hz": 50}, 'measures load, not current\n  feedback = .*"load"'),
        ({"model": 4242}, {}, "model number 4242"),
    ],
)
def test_a_model_that_does_not_fit_is_refused_with_what_to_write_instead(faults, keys, message):
    with (
        emulated("dynamixel", {**SETTINGS, **keys}, faults=faults) as bench,
        pytest.raises(DeviceError, match=message),
    ):
        bench.driver.open()


def test_old_firmware_is_read_without_fast_reads_and_extended_mode_is_set():
    settings = {
        **SETTINGS,
        "operating_mode": "extended-position",
        "position_gains": [900, 0, 100],
        "limits": {},
    }
    faults = {"model": 1020, "firmware": 40, "return-delay": 0}
    with emulated("dynamixel", settings, faults=faults) as bench:
        bench.driver.open()
        assert "Operating Mode 3 -> 4" in bench.driver.identify().details["servo_1.set_up"]
        assert any("knows no fast reads" in remark.message for remark in bench.driver.examine())
        _go(bench, [200.0, 0.0], 0.6)
        assert _goals(bench, "servo_1")[-1] == 2048 + round(200 / 360 * 4096)
