"""The simulated IMU: what it makes of an orientation, in the steps and ranges of the chip's registers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from simulated_bench import HandClock, StillScene, device

from labrun.errors import DeviceError

HEADING, ROLL, PITCH = 4, 5, 6


def _body(turn, rate=(0.0, 0.0, 0.0)):
    x, y, z, w = turn.as_quat()
    return {
        "camera_qw": w, "camera_qx": x, "camera_qy": y, "camera_qz": z,
        "camera_wx": rate[0], "camera_wy": rate[1], "camera_wz": rate[2],
    }  # fmt: skip


def _readings(scene, duration_s=20.0, seed=1, **keys):
    clock = HandClock()
    imu = device(
        "simulated-bno055",
        "imu",
        {"port": "p", "mounted_on": "camera", **keys},
        StillScene(scene),
        clock,
        seed,
    )
    imu.open()
    imu.start()
    clock.sleep(duration_s)
    return imu.read()


def test_values_are_whole_steps_of_the_registers():
    values = _readings(_body(Rotation.from_euler("x", 20, degrees=True), (0.1, -0.2, 0.3))).values
    for columns, step in [
        (slice(0, 4), 2.0**-14),
        (slice(4, 7), np.pi / 2880),
        (slice(7, 10), np.pi / 2880),
    ]:
        counts = values[:, columns] / step
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert len(np.unique(values[:, ROLL])) > 1


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 359), st.floats(-80, 80), st.floats(-170, 170))
def test_heading_roll_and_pitch_are_turns_about_z_x_and_y_in_that_order(heading, roll, pitch):
    turn = Rotation.from_euler("ZXY", [heading, roll, pitch], degrees=True)
    values = _readings(_body(turn), duration_s=3.0, mode="ndof").values
    result = np.degrees(values[:, 4:7]) - [heading, roll, pitch]
    result = ((result + 180) % 360 - 180).mean(axis=0)
    askew = 1.5 / np.cos(np.radians(roll))  # 0.3 deg askew; steep roll magnifies its part in the other two
    np.testing.assert_allclose(result, 0.0, atol=askew)
    assert values[:, HEADING].min() >= 0.0
    assert values[:, HEADING].max() < 2 * np.pi + 1e-9


@settings(max_examples=40, deadline=None)
@given(st.floats(-180, 180), st.floats(-80, 80), st.floats(-170, 170))
def test_the_quaternion_and_the_euler_angles_tell_the_same_orientation(heading, roll, pitch):
    values = _readings(_body(Rotation.from_euler("ZXY", [heading, roll, pitch], degrees=True)), 3.0).values
    by_quaternion = Rotation.from_quat(values[:, [1, 2, 3, 0]])
    by_angles = Rotation.from_euler("ZXY", values[:, 4:7])
    assert np.degrees((by_quaternion.inv() * by_angles).magnitude()).max() < 0.12
    np.testing.assert_allclose(np.linalg.norm(values[:, :4], axis=1), 1.0, atol=2e-4)


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 359), st.floats(0, 70), st.floats(-180, 180))
def test_tilt_is_how_far_the_bodys_z_axis_leans_whatever_its_heading(heading, lean, towards):
    values = _readings(_body(Rotation.from_euler("ZXZ", [towards, lean, heading], degrees=True)), 3.0).values
    assert np.degrees(values[:, 10].mean()) == pytest.approx(lean, abs=1.8)
    leaning = Rotation.from_quat(values[:, [1, 2, 3, 0]]).as_matrix()[:, 2, 2]
    np.testing.assert_allclose(np.cos(values[:, 10]), leaning, atol=1e-9)


def test_the_gyroscope_tells_the_rate_in_the_bodys_frame_and_saturates_at_2000_degrees_per_second():
    values = _readings(_body(Rotation.identity(), (0.5, -1.0, 0.25))).values
    np.testing.assert_allclose(values[:, 7:10].mean(axis=0), [0.5, -1.0, 0.25], atol=1e-3)
    np.testing.assert_allclose(values[:, 7:10].std(axis=0), np.radians(0.1), rtol=0.1)
    fast = _readings(_body(Rotation.identity(), (50.0, 0.0, 0.0)))
    assert fast.saturated == len(fast)
    np.testing.assert_allclose(fast.values[:, 7], np.radians(2000))


def test_it_is_glued_on_askew_the_same_way_for_the_whole_run_and_another_chip_another_way():
    level = _body(Rotation.identity())
    first, again, other = (_readings(level, seed=seed).values[:, ROLL:7].mean(axis=0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > np.radians(0.05)
    spread = [_readings(level, 1.0, seed=seed).values[:, ROLL].mean() for seed in range(60)]
    assert np.degrees(np.std(spread)) == pytest.approx(0.3, rel=0.4)


def test_without_its_magnetometer_heading_drifts_and_with_it_not():
    level = _body(Rotation.from_euler("z", 90, degrees=True))
    for mode, drifts in [("imu", True), ("ndof", False)]:
        heading = _readings(level, 100.0, seed=3, mode=mode).values[:, HEADING]
        moved = np.degrees(heading[-500:].mean() - heading[:500].mean())
        assert (abs(moved) > 0.1) == drifts


def test_samples_are_some_13_milliseconds_old_when_they_arrive_and_carry_no_time_of_their_own():
    samples = _readings(_body(Rotation.identity()))
    np.testing.assert_array_equal(samples.device_time_s, samples.host_time_s)
    assert samples.lost == 0
    age = samples.host_time_s - np.floor(samples.host_time_s * 100 - 1.28) / 100
    assert age.min() >= 0.0128 - 1e-9


def test_health_tells_the_calibration_in_the_chips_words():
    clock = HandClock()
    scene = StillScene(_body(Rotation.identity()))
    imu = device("simulated-bno055", "imu", {"port": "p", "mounted_on": "camera"}, scene, clock)
    imu.open()
    assert imu.health().notes == ("calibration: system 0, gyroscope 0, accelerometer 3, magnetometer 0",)
    clock.sleep(3.0)
    assert imu.health().notes == ("calibration: system 3, gyroscope 3, accelerometer 3, magnetometer 0",)
    assert imu.health().ok
    imu.close()
    assert not imu.health().ok


def test_a_body_the_bench_lacks_is_named_with_those_it_has():
    scene = StillScene(_body(Rotation.identity()))
    imu = device("simulated-bno055", "tip", {"port": "p", "mounted_on": "finger"}, scene, HandClock())
    with pytest.raises(DeviceError, match=r"tip: mounted_on = 'finger'[\s\S]*it has camera"):
        imu.open()


def test_a_bench_without_bodies_says_so():
    imu = device(
        "simulated-bno055", "tip", {"port": "p", "mounted_on": "base"}, StillScene({"x": 0}), HandClock()
    )
    with pytest.raises(DeviceError, match="it has none"):
        imu.open()
