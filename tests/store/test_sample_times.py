"""Times of samples: device clocks are mapped to the run's clock, always increasing, whatever the clocks do."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.signals import Signals
from labrun.store.timing import ClockMap, stream_report

RATE_HZ = 200.0


def trial_time(device_time_s, host_time_s, *, rate_hz, start_s):
    """Return a whole stream's trial-relative times, and how many of them had to be mended."""
    clock = ClockMap(rate_hz)
    clock.learn(device_time_s, host_time_s)
    return clock.mapper(start_s)(device_time_s), clock.glitches


def received(true_time_s, rng, *, delay_s=2e-3, least_s=0.0):
    """Host times of samples made at `true_time_s`, after random transport delays."""
    return true_time_s + least_s + rng.exponential(delay_s, len(true_time_s))


def stream(device_time_s, host_time_s, lost=0):
    time_s, _ = trial_time(device_time_s, host_time_s, rate_hz=RATE_HZ, start_s=0.0)
    values = np.zeros((len(time_s), 1))
    return Signals("wrench", ("f",), ("N",), time_s, values, {}, device_time_s, host_time_s, RATE_HZ, lost)


def test_the_offset_is_found_to_the_least_delay():
    rng = np.random.default_rng(1)
    true_time_s = np.arange(2000) / RATE_HZ
    time_s, glitches = trial_time(
        true_time_s + 1234.5, 50.0 + received(true_time_s, rng), rate_hz=RATE_HZ, start_s=50.0
    )
    assert glitches == 0
    np.testing.assert_allclose(time_s, true_time_s, atol=1e-4)


def test_a_drifting_clock_is_followed():
    rng = np.random.default_rng(2)
    true_time_s = np.arange(120_000) / RATE_HZ
    device_time_s = 3.0 + true_time_s * (1 - 80e-6)
    host_time_s = received(true_time_s, rng)
    time_s, _ = trial_time(device_time_s, host_time_s, rate_hz=RATE_HZ, start_s=0.0)
    drift_end_s = 80e-6 * true_time_s[-1]
    assert np.max(np.abs(time_s - true_time_s)) < 0.03 * drift_end_s
    report = stream_report(stream(device_time_s, host_time_s))
    assert report.drift_ppm == pytest.approx(80, abs=1)
    assert report.offset_s == pytest.approx(-3.0, abs=1e-3)


def test_a_host_that_stalls_for_a_second_does_not_move_the_samples():
    rng = np.random.default_rng(3)
    true_time_s = np.arange(2000) / RATE_HZ
    host_time_s = received(true_time_s, rng)
    stalled = (true_time_s > 4) & (true_time_s < 7)
    host_time_s[stalled] = 7.0
    time_s, glitches = trial_time(true_time_s + 9.0, host_time_s, rate_hz=RATE_HZ, start_s=0.0)
    assert glitches == 0
    np.testing.assert_allclose(time_s, true_time_s, atol=1e-4)


def test_a_counter_that_starts_again_gets_an_offset_of_its_own():
    rng = np.random.default_rng(4)
    true_time_s = np.arange(2000) / RATE_HZ
    device_time_s = np.where(true_time_s < 6, true_time_s + 70, true_time_s - 6)
    time_s, glitches = trial_time(device_time_s, received(true_time_s, rng), rate_hz=RATE_HZ, start_s=0.0)
    assert glitches == 1
    np.testing.assert_allclose(time_s, true_time_s, atol=5e-4)


def test_one_garbled_time_spoils_only_its_own_sample():
    rng = np.random.default_rng(5)
    true_time_s = np.arange(1000) / RATE_HZ
    device_time_s = true_time_s.copy()
    device_time_s[400] = 1e6
    time_s, glitches = trial_time(device_time_s, received(true_time_s, rng), rate_hz=RATE_HZ, start_s=0.0)
    assert glitches == 2
    assert np.all(np.diff(time_s) > 0)
    np.testing.assert_allclose(np.delete(time_s, 400), np.delete(true_time_s, 400), atol=0.02)


def test_a_device_without_a_clock_keeps_its_host_times():
    host_time_s = 10.0 + np.cumsum(np.random.default_rng(6).uniform(0.001, 0.02, 500))
    time_s, glitches = trial_time(host_time_s, host_time_s, rate_hz=RATE_HZ, start_s=10.0)
    assert glitches == 0
    np.testing.assert_array_equal(time_s, host_time_s - 10.0)


def test_samples_read_in_bursts_without_a_clock_are_spread():
    host_time_s = np.repeat(np.arange(1, 11) * 0.05, 10)
    time_s, glitches = trial_time(host_time_s, host_time_s, rate_hz=RATE_HZ, start_s=0.0)
    assert glitches == 0
    assert np.diff(time_s).min() == pytest.approx(0.5 / RATE_HZ)
    assert np.max(np.abs(time_s - host_time_s)) < 0.05


times = st.lists(st.floats(0, 1e5), min_size=1, max_size=80)


@given(device=times, host=times, start_s=st.floats(0, 1e5), clockless=st.booleans())
def test_times_increase_strictly_whatever_the_clocks_say(device, host, start_s, clockless):
    count = min(len(device), len(host))
    host_time_s = np.sort(np.array(host[:count]))
    device_time_s = host_time_s if clockless else np.array(device[:count])
    time_s, _ = trial_time(device_time_s, host_time_s, rate_hz=RATE_HZ, start_s=start_s)
    assert len(time_s) == count
    assert np.all(np.isfinite(time_s))
    assert np.all(np.diff(time_s) > 0)


@given(st.lists(st.integers(1, 3000), max_size=4), st.integers(0, 1000))
def test_learning_and_mapping_block_by_block_gives_the_same_times(cuts, seed):
    rng = np.random.default_rng(seed)
    true_time_s = np.arange(3000) / RATE_HZ
    device_time_s = np.where(true_time_s < 8, true_time_s * (1 + 1e-4), true_time_s - 8)
    host_time_s = received(true_time_s, rng)
    whole, _ = trial_time(device_time_s, host_time_s, rate_hz=RATE_HZ, start_s=0.0)
    clock = ClockMap(RATE_HZ)
    edges = sorted({0, 3000, *cuts})
    for start, end in pairwise(edges):
        clock.learn(device_time_s[start:end], host_time_s[start:end])
    mapper = clock.mapper(0.0)
    parts = [mapper(device_time_s[start:end]) for start, end in pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_a_report_tells_rate_jitter_and_losses():
    rng = np.random.default_rng(8)
    true_time_s = np.arange(4000) / RATE_HZ + rng.normal(0, 1e-4, 4000)
    kept = np.sort(rng.choice(4000, 3900, replace=False))
    kept[0], kept[-1] = 0, 3999
    report = stream_report(stream(true_time_s[kept] + 5, received(true_time_s, rng)[kept], lost=100))
    assert report.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert report.jitter_s == pytest.approx(1e-4 * np.sqrt(2), rel=0.1)
    assert report.lost == 100
    assert report.glitches == 0


def test_a_stream_of_one_sample_has_no_rate():
    report = stream_report(stream(np.array([1.0]), np.array([2.0])))
    assert np.isnan(report.rate_hz)
    assert report.offset_s == 1.0
    assert report.drift_ppm is None
