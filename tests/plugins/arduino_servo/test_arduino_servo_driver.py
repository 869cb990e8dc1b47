"""The driver against the emulator in another process: what goes over the wire, and what never does."""

import json
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from emulated import emulated
from labrun_plugins.arduino_servo.driver import ArduinoServo

from labrun import registry
from labrun.devices import Actuator, DeviceContext, Trajectory
from labrun.errors import DeviceError, LimitExceededError
from labrun.runner import RealClock

KEYS = {
    "port": "/dev/ttyACM0",
    "limits": {"angle_deg": [-60, 60], "speed_deg_s": 528},
    "joints": {"left": {"pin": 6, "sign": -1, "neutral_deg": 5.0}, "right": {"pin": 3}},
    "watchdog_ms": 500,  # tests share the machine with other work
}


def sine(joints, amplitude_deg=40.0, frequency_hz=1.4, duration_s=1.0):
    time_s = np.arange(0.0, duration_s + 1e-9, 0.01)
    angle = np.radians(amplitude_deg * np.sin(2 * np.pi * frequency_hz * time_s))
    return Trajectory(joints, time_s, np.column_stack([angle] * len(joints)), 1 / frequency_hz)


def still(joints, angle_deg):
    return Trajectory(joints, np.zeros(1), np.full((1, len(joints)), np.radians(angle_deg)))


@pytest.fixture(scope="module")
def shared():
    with emulated("arduino-servo", KEYS, name="fins") as bench:
        yield bench


@pytest.fixture
def bench(shared):
    shared.driver.open()
    yield shared
    shared.driver.safe_stop()
    shared.driver.close()


def _now(bench):
    return bench.clock.now()


def _commands(bench, after_s):
    return [line for line in bench.events("command") if line["time_s"] >= after_s]


def test_opening_moves_nothing(shared):
    begun_s = _now(shared)
    shared.driver.open()
    assert isinstance(shared.driver, Actuator)
    assert shared.driver.joints == ("left", "right")
    assert shared.driver.health().ok
    assert shared.driver.pose() == pytest.approx({"left": 0.0, "right": 0.0}, abs=1e-9)
    shared.driver.close()
    assert not [x for x in shared.log() if x["time_s"] >= begun_s and x["event"] in {"command", "attached"}]


def test_it_says_what_it_is_and_what_stands_between_angle_and_pulse(bench):
    identity = bench.driver.identify()
    assert identity.firmware == "labservo 1.0"
    assert "none" in identity.details["feedback"]
    assert "pin 6" in identity.details["joint left"]
    assert "-1 * angle + 5 deg" in identity.details["joint left"]


def test_a_motion_arrives_as_pulses_at_50_hz_with_the_watchdog_armed(bench):
    begun_s = _now(bench)
    motion = sine(("left", "right"), duration_s=1.0)
    start_s = begun_s + 0.1
    bench.driver.follow(motion, start_s)
    bench.wait_until(lambda: _now(bench) > start_s + 1.1)
    first, *sent = _commands(bench, begun_s)
    assert all(line["watchdog_ms"] == KEYS["watchdog_ms"] for line in [first, *sent])
    assert first["pulses_us"] == [
        1500,
        -1,
        1550,
        -1,
    ]  # the beginning of the motion, before the outputs are on
    assert bench.driver.pacing().sent == len(sent)
    assert len(sent) + bench.driver.pacing().missed == 51
    assert all(line["pulses_us"][1] == line["pulses_us"][3] == -1 for line in sent)
    right = np.array([line["pulses_us"][0] for line in sent])
    left = np.array([line["pulses_us"][2] for line in sent])
    angles = np.degrees(motion.at(np.arange(51) * 0.02)[:, 0])
    assert set(right) <= set(np.round(1500 + 10 * angles).astype(int))
    assert np.all(np.abs((left - 1550) + (right - 1500)) <= 1)  # the same angle, the other way round
    assert set(np.degrees(list(bench.driver.pose().values())).round(1)) == {angles[-1].round(1)}


def test_limits_are_told_to_the_firmware_as_pulses(bench):
    begun_s = _now(bench)
    bench.driver.follow(still(("left", "right"), 0.0), begun_s)
    bench.wait_until(lambda: len([x for x in bench.events("attached") if x["time_s"] >= begun_s]) == 2)
    windows = {x["channel"]: x["limits_us"] for x in bench.events("attached") if x["time_s"] >= begun_s}
    assert windows == {0: [900, 2100], 2: [950, 2150]}


def test_a_motion_beyond_its_limits_is_refused_whole_and_nothing_of_it_is_sent(bench):
    begun_s = _now(bench)
    beyond = [still(("left", "right"), 61.0), sine(("left", "right"), 60.0, frequency_hz=2.0)]
    for motion in beyond:
        with pytest.raises(LimitExceededError, match=r"device fins.*limit of"):
            bench.driver.follow(motion, begun_s)
    with pytest.raises(DeviceError, match="drives left, right"):
        bench.driver.follow(still(("right",), 0.0), begun_s)
    bench.driver.health()
    assert _commands(bench, begun_s) == []


def test_a_set_point_beyond_its_limits_is_not_sent_even_if_the_motion_was_let_through(bench):
    begun_s = _now(bench)
    bench.driver.follow(still(("left", "right"), 10.0), begun_s)
    bench.wait_for("command", after_s=begun_s)
    for angles_deg in ([70.0, 0.0], [0.0, np.nan], [0.0, -60.2]):
        with pytest.raises(LimitExceededError, match="it was not sent"):
            bench.driver._board.send(np.radians(angles_deg))
    pulses = [pulse for line in _commands(bench, begun_s) for pulse in line["pulses_us"]]
    assert set(pulses) == {-1, 1600, 1450}


def test_the_firmware_refuses_pulses_beyond_its_limits_by_itself(bench):
    bench.driver.follow(still(("left", "right"), 0.0), _now(bench))
    with pytest.raises(DeviceError, match=r"device fins.*RANGE,0"):
        bench.driver._board.session.request("SV", 2400, -1, 1500, -1)


def test_a_stop_reaches_the_board_within_100_ms_and_nothing_moves_until_the_next_motion(bench):
    bench.driver.follow(sine(("left", "right"), duration_s=20.0), _now(bench))
    bench.wait_until(lambda: bench.driver.pacing().sent > 10)
    asked_s = _now(bench)
    bench.driver.safe_stop()
    stop = bench.wait_for("stop", after_s=asked_s)
    assert stop["time_s"] - asked_s < 0.1
    bench.driver.safe_stop()
    bench.clock.sleep(0.3)
    assert not _commands(bench, stop["time_s"])
    held_us = stop["pulses_us"]
    assert np.degrees(bench.driver.pose()["right"]) == pytest.approx((held_us[0] - 1500) / 10)
    again_s = _now(bench)
    bench.driver.follow(still(("left", "right"), 0.0), again_s)
    bench.wait_for("command", after_s=again_s)


def test_a_stop_does_not_wait_for_a_request_that_another_thread_has_under_way(bench):
    bench.driver.follow(sine(("left", "right"), duration_s=20.0), _now(bench))
    bench.wait_until(lambda: bench.driver.pacing().sent > 5)
    bench.inject("silence")

    def ask():
        with pytest.raises(DeviceError):
            bench.driver.health()

    asking = threading.Thread(target=ask)
    asking.start()
    bench.clock.sleep(0.02)
    asked_s = _now(bench)
    bench.driver.safe_stop()
    asking.join()
    bench.clear("silence")
    stops = [x["time_s"] for x in bench.events("stop") if x["time_s"] >= asked_s]
    assert stops[0] - asked_s < 0.1
    assert len(stops) == 2  # asked again, as the first stayed unanswered
    assert not _commands(bench, stops[0])


def test_a_motion_that_a_stop_overtakes_is_not_begun(bench):
    begun_s = _now(bench)
    session = bench.driver._board.session
    arm = session.arm

    def arm_and_be_stopped(watchdog_ms):
        arm(watchdog_ms)
        bench.driver.safe_stop()

    session.arm = arm_and_be_stopped
    try:
        bench.driver.follow(sine(("left", "right")), begun_s)
    finally:
        session.arm = arm
    bench.clock.sleep(0.2)
    assert _commands(bench, begun_s) == []


def test_a_motion_that_never_was_allowed_leaves_no_command_behind_a_stop(bench):
    bench.driver.follow(sine(("left", "right"), duration_s=20.0), _now(bench))
    bench.wait_until(lambda: bench.driver.pacing().sent > 5)
    bench.driver._board.session.stop()  # the set-points' own thread goes on, and finds that it must not send
    stopped_s = bench.events("stop")[-1]["time_s"]
    bench.clock.sleep(0.2)
    assert not _commands(bench, stopped_s)


def test_the_watchdog_gets_more_time_once_a_motion_has_ended(bench):
    begun_s = _now(bench)
    bench.driver.follow(still(("left", "right"), 0.0), begun_s)
    bench.wait_until(lambda: bench.events("armed")[-1]["watchdog_ms"] == 1000, within_s=3.0)
    bench.clock.sleep(1.5)
    assert not [x for x in bench.events("watchdog") if x["time_s"] >= begun_s]
    again_s = _now(bench)
    bench.driver.follow(still(("left", "right"), 1.0), again_s)
    bench.wait_for("command", after_s=again_s)
    armed = [x for x in bench.events("armed") if x["time_s"] >= again_s]
    assert armed[0]["watchdog_ms"] == KEYS["watchdog_ms"]
    assert armed[0]["time_s"] <= _commands(bench, again_s)[0]["time_s"]


def test_a_regular_close_turns_the_watchdog_off(shared):
    begun_s = _now(shared)
    shared.driver.open()
    shared.driver.follow(still(("left", "right"), 0.0), begun_s)
    shared.driver.close()
    shared.driver.close()
    shared.clock.sleep(0.4)
    assert shared.events("armed")[-1]["watchdog_ms"] == 0
    assert not [x for x in shared.events("watchdog") if x["time_s"] >= begun_s]


def test_probe_finds_the_board_and_leaves_the_port_free(shared):
    identity = ArduinoServo.probe(str(shared.bench.settings["fins"]["port"]))
    assert identity is not None
    assert (identity.model, identity.firmware) == ("labservo", "1.0")
    shared.driver.open()
    shared.driver.close()
    assert ArduinoServo.probe("/dev/no-such-port") is None


def test_doctor_learns_firmware_channels_rate_and_watchdog(bench):
    remarks = bench.driver.examine()
    assert {remark.verdict for remark in remarks} == {"ok"}
    text = " ".join(remark.message for remark in remarks)
    for part in ("labservo 1.0", "4 channels, 3 needed", "50 are sent", "watchdog takes 500 ms"):
        assert part in text


def test_an_emergency_stop_connects_from_scratch(shared):
    settings = shared.driver._settings
    asked_s = _now(shared)
    ArduinoServo.emergency_stop("fins", settings)
    assert shared.wait_for("stop", after_s=asked_s)["time_s"] - asked_s < 0.5
    shared.driver.open()
    shared.driver.close()


CHILD = """
import json, sys, time, numpy as np
from labrun import registry
from labrun.devices import DeviceContext, Trajectory
from labrun.runner import RealClock
make = registry.load("labrun.devices", "arduino-servo")
clock = RealClock()
driver = make("fins", make.Settings(**json.loads(sys.argv[1])), DeviceContext(clock, np.random.default_rng(0)))
driver.open()
time_s = np.arange(0.0, 30.0, 0.02)
angle = np.radians(30 * np.sin(2 * np.pi * time_s))
driver.follow(Trajectory(("left", "right"), time_s, np.column_stack([angle, angle])), clock.now())
print("moving", flush=True)
time.sleep(30)
"""


def test_a_runner_that_is_killed_stops_the_servos_within_the_watchdogs_time(shared):
    keys = {**KEYS, **shared.bench.settings["fins"], "watchdog_ms": 100}
    begun_s = _now(shared)
    child = subprocess.Popen([sys.executable, "-c", CHILD, json.dumps(keys)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    with child:
        assert child.stdout.readline() == b"moving\n"
        shared.wait_until(lambda: len(_commands(shared, begun_s)) > 20)
        child.send_signal(signal.SIGKILL)
    expired = shared.wait_for("watchdog", after_s=begun_s)
    last_s = _commands(shared, begun_s)[-1]["time_s"]
    # 100 ms and the emulator's own wake-up, for which a loaded machine is given as much again
    assert expired["time_s"] - last_s < 0.2
    assert expired["watchdog_ms"] == 100
    shared.clock.sleep(0.1)
    assert shared.events("stop")[-1]["how"] == "watchdog"


def test_the_bench_moves_as_in_a_dry_run():
    keys = {"port": "p", "limits": {"angle_deg": [-60, 60]}}
    motion = sine(("tail",), 40.0, 1.4, 2.0)
    with emulated("arduino-servo", keys, name="tail", scene="caudal-tank") as bench:
        bench.driver.open()
        start_s = bench.clock.now() + 0.3
        bench.driver.follow(motion, start_s)
        bench.wait_until(lambda: bench.clock.now() > start_s + 2.3)
        time_s = np.arange(0.0, 2.2, 0.01)
        assert bench.bench.scene is not None
        seen = bench.bench.scene.observe(("tail",), start_s + time_s)[:, 0]
        bench.driver.close()
    made = registry.load("labrun.devices", "simulated-arduino-servo")

    class Scene:
        joints = ("tail",)

        def drive(self, joint, trajectory, start_s):
            self.motion = trajectory

    scene = Scene()
    stand_in = made(
        "tail", made.Settings(**keys), DeviceContext(RealClock(), np.random.default_rng(0), scene)
    )
    stand_in.open()
    stand_in.follow(motion, 0.0)
    expected = scene.motion.at(time_s)[:, 0]
    # At 350 deg/s a millisecond of delay on the wire makes a third of a degree.
    lag_s = min(
        np.arange(-0.01, 0.04, 0.0005),
        key=lambda late: float(np.std(seen - scene.motion.at(time_s - late)[:, 0])),
    )
    assert -0.005 < lag_s < 0.03
    left = np.degrees(np.std(seen - scene.motion.at(time_s - lag_s)[:, 0]))
    # a set-point that this machine sends 20 ms late is 7 deg off while it waits; the swing itself is 28 deg sd
    assert left < 4.0, left
    assert np.ptp(seen) == pytest.approx(np.ptp(expected), rel=0.03)
