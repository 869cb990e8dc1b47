"""Servos, operator and carriage: what they pass on to the bench, and what they refuse."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.hinge.scene import HingeBench
from simulated_bench import HandClock, StillScene, device, line, sine

from labrun import registry
from labrun.devices import Actuator, Carriage, Trajectory
from labrun.errors import DeviceError, LimitExceededError

SCENE = {"position": 0.1}
SERVOS = [
    ("simulated-servo", {}),
    ("simulated-arduino-servo", {"port": "/dev/ttyACM0"}),
    ("simulated-dynamixel", {"port": "/dev/ttyUSB0", "joints": {"tail": {"id": 1}}}),
]


def _servo(plugin, keys, clock=None):
    scene = StillScene(SCENE)
    servo = device(plugin, "tail", keys, scene, clock or HandClock(3.0))
    servo.open()
    return servo, scene


@pytest.mark.parametrize(("plugin", "keys"), SERVOS)
def test_a_servo_follows_a_gait_with_its_lag(plugin, keys):
    servo, scene = _servo(plugin, keys)
    assert isinstance(servo, Actuator)
    assert servo.joints == ("tail",)
    servo.follow(sine("tail", 40, 1.0, 5.0), 3.0)
    joint, motion, start_s = scene.driven[-1]
    assert (joint, start_s) == ("tail", 3.0)
    time_s = np.arange(1.0, 5.0, 0.005)
    basis = np.exp(-2j * np.pi * time_s)
    response = (
        2
        * np.mean(motion.at(time_s)[:, 0] * basis)
        / np.radians(40)
        / (2 * np.mean(np.sin(2 * np.pi * time_s) * basis))
    )
    shaft = servo._shaft
    ratio = 1.0 / shaft.natural_hz
    loop = 1 / (1 - ratio**2 + 2j * shaft.damping * ratio)
    hold = np.exp(-1j * np.pi * shaft.frame_s)  # a command held for a frame is half a frame late
    assert response == pytest.approx(loop * hold, abs=0.01)
    assert 0.97 < abs(response) <= 1.001
    assert -0.07 * 2 * np.pi < np.angle(response) < 0


def test_on_a_bench_that_has_to_agree_with_a_model_a_servo_takes_no_steps_and_is_as_late():
    coarse, fine = StillScene(SCENE), StillScene(SCENE)
    fine.smooth_drives = True
    time_s = np.arange(1.0, 30.0, 0.005)
    angles = []
    for scene in (coarse, fine):
        servo = device("simulated-arduino-servo", "tail", {"port": "p"}, scene, HandClock(3.0))
        servo.open()
        servo.follow(sine("tail", 66, 0.1, 30.0), 3.0)
        angles.append(np.degrees(scene.driven[-1][1].at(time_s)[:, 0]))
    shaft = servo._shaft
    delay_s = 0.5 * shaft.frame_s
    loop = 1 / (1 - (0.1 / shaft.natural_hz) ** 2 + 2j * shaft.damping * 0.1 / shaft.natural_hz)
    exact = np.imag(66 * loop * np.exp(2j * np.pi * 0.1 * (time_s - delay_s)))
    assert np.max(np.abs(angles[1] - exact)) < 0.01
    assert 0.1 < np.max(np.abs(angles[0] - exact)) < 0.5


@pytest.mark.parametrize(("plugin", "keys"), SERVOS)
def test_a_servo_shaft_accelerates_without_jumps_of_speed(plugin, keys):
    servo, scene = _servo(plugin, keys)
    servo.follow(sine("tail", 40, 1.4, 3.0), 3.0)
    motion = scene.driven[-1][1]
    speed = np.diff(motion.angle_rad[:, 0]) / np.diff(motion.time_s)
    top = np.radians(40) * 2 * np.pi * 1.4
    # The command steps once a frame; what is left of that in the shaft's speed is a ripple.
    later = motion.time_s[1:] > 0.5
    smooth = np.convolve(speed, np.ones(9) / 9, "same")
    assert np.abs(speed - smooth)[later][:-20].max() < 0.12 * top


def test_an_rc_servo_moves_in_pulse_steps_below_its_speed_and_gives_no_feedback():
    clock = HandClock(3.0)
    servo, scene = _servo("simulated-arduino-servo", {"port": "p"}, clock)
    servo.follow(line("tail", [0.0, 60.0], [0.0, 0.001]), 3.0)
    motion = scene.driven[-1][1]
    speed = np.diff(np.degrees(motion.angle_rad[:, 0])) / np.diff(motion.time_s)
    assert speed.max() == pytest.approx(600.0, rel=1e-6)
    assert np.degrees(motion.angle_rad[-1, 0]) == pytest.approx(60.0, abs=0.21)
    clock.sleep(0.01)
    assert servo.pose()["tail"] == pytest.approx(np.radians(60.0))  # commanded, although it is not there yet


def test_an_rc_servo_ignores_commands_inside_its_dead_band():
    servo, scene = _servo("simulated-arduino-servo", {"port": "p"})
    servo.follow(line("tail", [0.0, 0.15], [0.0, 1.0]), 3.0)
    assert np.ptp(scene.driven[-1][1].angle_rad) == 0.0


def test_a_dynamixel_reports_where_it_is_in_whole_counts():
    clock = HandClock(3.0)
    servo, _ = _servo("simulated-dynamixel", {"port": "p", "joints": {"tail": {"id": 1}}}, clock)
    servo.follow(line("tail", [0.0, 30.0], [0.0, 0.5]), 3.0)
    clock.sleep(0.25)
    count = servo.pose()["tail"] / (2 * np.pi / 4096)
    assert count == pytest.approx(round(count), abs=1e-9)
    assert 0 < servo.pose()["tail"] < np.radians(15.1)


def test_two_dynamixels_with_one_id_are_refused():
    made = registry.load("labrun.devices", "simulated-dynamixel")
    with pytest.raises(ValueError, match="both have id 1"):
        made.Settings(port="p", joints={"a": {"id": 1}, "b": {"id": 1}})


def test_a_reversed_servo_turns_its_joint_the_other_way():
    servo, scene = _servo("simulated-servo", {"joints": {"tail": {"sign": -1}}})
    servo.follow(line("tail", [0.0, 20.0], [0.0, 1.0]), 3.0)
    assert scene.driven[-1][1].angle_rad[-1, 0] == pytest.approx(-np.radians(20.0), abs=1e-4)
    assert servo.pose()["tail"] == pytest.approx(0.0)


@pytest.mark.parametrize(("plugin", "keys"), SERVOS)
@settings(max_examples=20, deadline=None)
@given(amplitude=st.floats(61.0, 89.0))
def test_a_motion_beyond_the_limits_is_refused_whole(plugin, keys, amplitude):
    servo, scene = _servo(plugin, {**keys, "limits": {"angle_deg": [-60, 60]}})
    with pytest.raises(LimitExceededError, match="nothing was sent"):
        servo.follow(sine("tail", amplitude, 0.3, 5.0), 3.0)
    assert scene.driven == []


def test_an_rc_servo_refuses_pulses_beyond_its_range_even_without_limits():
    servo, scene = _servo("simulated-arduino-servo", {"port": "p", "joints": {"tail": {"neutral_deg": 80}}})
    with pytest.raises(DeviceError, match=r"pulses of .* leave 500 to 2500 us"):
        servo.follow(sine("tail", 40, 0.3, 5.0), 3.0)
    assert scene.driven == []


@pytest.mark.parametrize(("plugin", "keys"), SERVOS)
def test_safe_stop_holds_where_the_shaft_is_at_any_time_and_any_number_of_times(plugin, keys):
    clock = HandClock(3.0)
    servo, scene = _servo(plugin, keys, clock)
    servo.safe_stop()  # before any motion
    servo.follow(line("tail", [0.0, 40.0], [0.0, 1.0]), 3.0)
    clock.sleep(0.5)
    servo.safe_stop()
    servo.safe_stop()
    _, hold, start_s = scene.driven[-1]
    assert start_s == 3.5
    assert 0 < np.degrees(hold.angle_rad[-1, 0]) < 21
    servo.close()
    servo.safe_stop()


def test_stops_leave_their_witness_lines(tmp_path):
    log = tmp_path / "stops"
    keys = {"port": "p", "stop_log": str(log)}
    servo, _ = _servo("simulated-arduino-servo", keys)
    servo.safe_stop()
    made = type(servo)
    made.emergency_stop("tail", made.Settings(**keys))
    lines = [line.split() for line in log.read_text().splitlines()]
    assert [(int(words[0]), words[2], words[3]) for words in lines] == [
        (os.getpid(), "tail", "safe_stop"), (os.getpid(), "tail", "emergency_stop"),
    ]  # fmt: skip


def test_a_stop_does_not_fail_because_its_witness_cannot_write(tmp_path):
    servo, _ = _servo("simulated-servo", {"stop_log": str(tmp_path / "absent" / "stops")})
    servo.safe_stop()


def test_a_servo_that_no_longer_answers_refuses_commands():
    clock = HandClock(3.0)
    servo, _ = _servo("simulated-servo", {"faults": {"stop_answering_after_s": 1.0}}, clock)
    clock.sleep(1.5)
    with pytest.raises(DeviceError, match="does not answer"):
        servo.follow(sine("tail", 10, 1.0, 1.0), clock.now())


def test_a_joint_the_bench_lacks_is_named_with_those_it_has():
    servo = device("simulated-servo", "tail", {"joints": {"fluke": {}}}, StillScene(SCENE), HandClock())
    with pytest.raises(DeviceError, match=r"no joint fluke\n  it has tail"):
        servo.open()


def test_the_carriage_moves_within_its_travel_only():
    scene = StillScene(SCENE)
    arm = device(
        "simulated-ur5",
        "arm",
        {"host": "h", "limits": {"travel_m": [0, 0.5], "speed_m_s": 0.1}},
        scene,
        HandClock(2.0),
    )
    arm.open()
    assert isinstance(arm, Carriage)
    assert arm.position_m() == pytest.approx(0.1)
    for to_m, speed in [(0.6, 0.05), (0.3, 0.2)]:
        with pytest.raises(LimitExceededError, match="not sent"):
            arm.travel(to_m, speed)
    with pytest.raises(DeviceError, match="above zero"):
        arm.travel(0.3, 0.0)
    assert scene.towed == []
    arm.travel(0.4, 0.1)
    assert scene.towed == [(0.1, 0.4, 0.1, 2.0)]
    arm.safe_stop()
    assert scene.towed[-1] == (0.1, 0.1, 0.0, 2.0)


def test_the_operator_places_a_body_holds_it_and_lets_it_go():
    clock = HandClock(1.0)
    scene = HingeBench({"noise": 0}, np.random.default_rng(0))
    operator = device("simulated-operator", "hand", {}, scene, clock)
    operator.open()
    operator.follow(line("hinge", [0.0, 30.0], [0.0, 1.0]), clock.now())
    clock.sleep(5.0)
    held = operator.pose()["hinge"]
    assert np.degrees(held) == pytest.approx(30.0, abs=1.0)
    release = Trajectory(("hinge",), np.linspace(0, 2, 50), np.full((50, 1), np.radians(30.0)))
    operator.follow(release, clock.now())
    assert operator.pose()["hinge"] == pytest.approx(held, abs=1e-3)
    clock.sleep(0.15)
    assert operator.pose()["hinge"] < 0.5 * held
    clock.sleep(30.0)
    assert abs(operator.pose()["hinge"]) < 1e-3
