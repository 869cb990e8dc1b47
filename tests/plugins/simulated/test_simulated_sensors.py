"""Rates, noise, steps, range, losses and latency of the simulated sensors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_bench import HandClock, StillScene, device

from labrun.devices import Sensor, Tracker
from labrun.errors import DeviceError

SIX = {"force_x": 1.0, "force_y": 2.0, "force_z": 0.0, "torque_x": 0.1, "torque_y": 0.0, "torque_z": 0.05}
POSE = {
    f"arm_{part}": value
    for part, value in zip(["x", "y", "z", "qx", "qy", "qz", "qw"], [0, 0, 1, 0, 0, 0, 1], strict=True)
}
BODY = {"base_qw": 1.0, **{f"base_{part}": 0.0 for part in ["qx", "qy", "qz", "wx", "wy", "wz"]}}
SENSORS = [
    ("simulated-robotiq-ft300", {"port": "/dev/ttyUSB0"}, SIX, 100.0),
    ("simulated-ati-netft", {"host": "192.168.1.1", "rate_hz": 500}, SIX, 500.0),
    ("simulated-optitrack", {"host": "192.168.1.2"}, POSE, 360.0),
    ("simulated-ur5", {"host": "192.168.1.3"}, {"position": 0.25}, 125.0),
    ("simulated-bno055", {"port": "/dev/ttyUSB1", "mounted_on": "base"}, BODY, 100.0),
]


def _streaming(plugin, keys, scene_values, clock=None, seed=1):
    clock = clock or HandClock(5.0)
    sensor = device(plugin, "sensor", keys, StillScene(scene_values), clock, seed)
    sensor.open()
    sensor.start()
    return sensor, clock


@pytest.mark.parametrize(("plugin", "keys", "values", "rate"), SENSORS)
def test_a_sensor_delivers_its_true_rate_with_monotonic_times_and_latency(plugin, keys, values, rate):
    sensor, clock = _streaming(plugin, keys, values)
    assert isinstance(sensor, Sensor)
    assert sensor.rate_hz == pytest.approx(rate)
    clock.sleep(20.0)
    samples = sensor.read()
    assert len(samples) + samples.lost == pytest.approx(20 * rate, abs=0.01 * rate + 5)
    assert np.all(np.diff(samples.host_time_s) >= 0)
    assert np.all(np.diff(samples.device_time_s) >= 0)
    assert samples.host_time_s[-1] <= clock.now()
    assert samples.values.shape == (len(samples), len(sensor.channels))
    assert len(sensor.read()) == 0


@pytest.mark.parametrize(("plugin", "keys", "values", "rate"), SENSORS)
@settings(max_examples=15, deadline=None)
@given(pauses=st.lists(st.floats(0.0, 0.4), min_size=1, max_size=20))
def test_however_often_it_is_read_no_sample_is_given_twice_or_forgotten(plugin, keys, values, rate, pauses):
    sensor, clock = _streaming(plugin, keys, values)
    count = 0
    last = 5.0
    for pause in pauses:
        clock.sleep(pause)
        samples = sensor.read()
        count += len(samples) + samples.lost
        if len(samples):
            assert samples.host_time_s[0] >= last
            last = samples.host_time_s[-1]
    elapsed = clock.now() - 5.0
    # what is under way (latency) or lost without a counter has not been counted
    assert elapsed * rate - 0.02 * rate - 6 <= count <= elapsed * rate + 1


def test_device_time_runs_by_the_device_s_clock_and_reveals_the_latency():
    sensor, clock = _streaming("simulated-ati-netft", {"host": "h"}, SIX)
    clock.sleep(10.0)
    samples = sensor.read()
    period = np.diff(samples.device_time_s)
    assert np.median(period) == pytest.approx((1 + 2e-5) / 500, rel=1e-6)
    offset = samples.host_time_s - samples.device_time_s
    assert offset.min() == pytest.approx(np.percentile(offset, 5), abs=3e-4)
    assert np.ptp(offset) > 1e-4


def test_ft300_has_no_clock_and_no_counter_so_lost_frames_show_only_as_gaps():
    keys = {"port": "p", "faults": {"drop_share": 0.2}}
    sensor, clock = _streaming("simulated-robotiq-ft300", keys, SIX)
    clock.sleep(20.0)
    samples = sensor.read()
    assert samples.lost == 0
    assert len(samples) < 0.9 * 2000
    np.testing.assert_array_equal(samples.device_time_s, samples.host_time_s)
    assert np.diff(samples.host_time_s).max() > 0.015


def test_dropouts_are_counted_where_the_device_counts_frames():
    keys = {"host": "h", "faults": {"drop_share": 0.1}}
    sensor, clock = _streaming("simulated-ati-netft", keys, SIX)
    clock.sleep(20.0)
    samples = sensor.read()
    assert samples.lost == pytest.approx(1000, rel=0.15)
    assert len(samples) + samples.lost == pytest.approx(10_000, abs=5)


@pytest.mark.parametrize(
    ("plugin", "keys", "step"),
    [
        ("simulated-robotiq-ft300", {"port": "p"}, [0.01] * 3 + [0.001] * 3),
        ("simulated-ati-netft", {"host": "h"}, [0.005, 0.005, 0.01] + [1 / 8000] * 3),
        ("simulated-ati-netft", {"host": "h", "calibration": "SI-80-4"}, [0.02, 0.02, 0.04] + [4 / 8000] * 3),
    ],
)
def test_values_are_whole_steps_of_the_sensor(plugin, keys, step):
    sensor, clock = _streaming(plugin, keys, SIX)
    clock.sleep(2.0)
    counts = sensor.read().values / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_noise_offset_and_signal_add_up():
    clock = HandClock()
    loaded = device("simulated-robotiq-ft300", "w", {"port": "p"}, StillScene(SIX), clock, seed=3)
    empty = device(
        "simulated-robotiq-ft300", "w", {"port": "p"}, StillScene(dict.fromkeys(SIX, 0.0)), clock, seed=3
    )
    means = []
    for sensor in (loaded, empty):
        sensor.open()
        sensor.start()
    clock.sleep(60.0)
    for sensor in (loaded, empty):
        values = sensor.read().values
        means.append(values.mean(axis=0))
        np.testing.assert_allclose(values.std(axis=0), [0.1, 0.1, 0.1, 0.005, 0.005, 0.003], rtol=0.1)
    assert np.abs(means[1][:3]).max() > 0.3  # it wakes up with an offset: hence a tare
    np.testing.assert_allclose(means[0] - means[1], list(SIX.values()), atol=0.01)


@pytest.mark.parametrize(
    ("plugin", "keys", "force", "torque"),
    [
        ("simulated-robotiq-ft300", {"port": "p"}, 300.0, 30.0),
        ("simulated-ati-netft", {"host": "h"}, 20.0, 1.0),
    ],
)
def test_a_load_beyond_the_range_is_clipped_and_counted(plugin, keys, force, torque):
    sensor, clock = _streaming(plugin, keys, {**SIX, "force_x": 2 * force, "torque_z": -2 * torque})
    clock.sleep(1.0)
    samples = sensor.read()
    assert samples.saturated == len(samples)
    np.testing.assert_allclose(samples.values[:, 0], force)
    np.testing.assert_allclose(samples.values[:, 5], -torque)


def test_ati_rate_is_a_whole_fraction_of_7000():
    for wanted, true in [(1000, 1000.0), (900, 875.0), (7000, 7000.0), (4000, 3500.0)]:
        sensor, _ = _streaming("simulated-ati-netft", {"host": "h", "rate_hz": wanted}, SIX)
        assert sensor.rate_hz == pytest.approx(true)


def test_optitrack_gives_unit_quaternions_and_the_angles_asked_for():
    half = 0.3
    pose = {**POSE, "arm_qy": np.sin(half), "arm_qw": np.cos(half)}
    keys = {
        "host": "h",
        "angles": {"angle": {"body": "arm", "axis": [0, 2, 0]}, "roll": {"body": "arm", "axis": [1, 0, 0]}},
    }
    sensor, clock = _streaming("simulated-optitrack", keys, pose)
    assert isinstance(sensor, Tracker)
    assert [channel.name for channel in sensor.channels][-2:] == ["angle", "roll"]
    clock.sleep(20.0)
    values = sensor.read().values
    np.testing.assert_allclose(np.linalg.norm(values[:, 3:7], axis=1), 1.0, atol=1e-12)
    assert values[:, 7].mean() == pytest.approx(0.6, abs=1e-4)
    assert values[:, 7].std() == pytest.approx(1.5e-3, rel=0.1)
    assert values[:, :3].std(axis=0) == pytest.approx([1e-4] * 3, rel=0.1)


def test_a_body_nobody_can_see_is_named_when_the_tracker_opens():
    tracker = device(
        "simulated-optitrack", "cameras", {"host": "h", "bodies": ["leg"]}, StillScene(POSE), HandClock()
    )
    with pytest.raises(DeviceError, match="cameras: this bench has no leg_x"):
        tracker.open()


def test_a_sensor_that_falls_silent_is_reported_by_name_and_time():
    keys = {"port": "p", "faults": {"stop_answering_after_s": 2.0}}
    sensor, clock = _streaming("simulated-robotiq-ft300", keys, SIX)
    clock.sleep(1.0)
    assert len(sensor.read()) > 90
    clock.sleep(2.0)
    assert len(sensor.read()) == pytest.approx(100, abs=5)  # what it sent before it fell silent
    with pytest.raises(DeviceError, match="sent nothing for"):
        sensor.read()
    assert not sensor.health().ok


def test_nonsense_and_saturation_come_on_request():
    keys = {"port": "p", "faults": {"nonsense_after_s": 0.0}}
    sensor, clock = _streaming("simulated-robotiq-ft300", keys, SIX)
    clock.sleep(1.0)
    assert np.isnan(sensor.read().values).any()
    sensor, clock = _streaming("simulated-robotiq-ft300", {"port": "p", "faults": {"saturate": True}}, SIX)
    clock.sleep(1.0)
    samples = sensor.read()
    assert samples.saturated == len(samples)


def test_the_same_seed_gives_the_same_samples_again():
    blocks = []
    for _ in range(2):
        sensor, clock = _streaming("simulated-ati-netft", {"host": "h"}, SIX, HandClock(7.0))
        sensor.reseed(np.random.SeedSequence((4, 2)))
        clock.sleep(1.0)
        blocks.append(sensor.read())
    np.testing.assert_array_equal(blocks[0].values, blocks[1].values)
    np.testing.assert_array_equal(blocks[0].host_time_s, blocks[1].host_time_s)


def test_a_closed_or_stopped_sensor_says_what_comes_first():
    sensor = device("simulated-robotiq-ft300", "w", {"port": "p"}, StillScene(SIX), HandClock())
    with pytest.raises(DeviceError, match="is not open"):
        sensor.start()
    sensor.open()
    with pytest.raises(DeviceError, match="is not streaming"):
        sensor.read()
    sensor.close()
    sensor.close()
    assert sensor.closed


def test_a_dry_run_without_a_scene_is_told_to_name_one():
    sensor = device("simulated-robotiq-ft300", "w", {"port": "p"}, None, HandClock())
    with pytest.raises(DeviceError, match="needs a simulated bench"):
        sensor.open()
