"""Settling on evidence: noise alone is rest, a dying wave under the noise is not."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from labrun.devices import Samples
from labrun.runner.stillness import BaselineMeter, Bounds, SettleDetector, Watched, stillness

RATE_HZ = 100.0
HOLD_S = 2.0
WATCHED = (Watched("cell", 0, "cell.force_x", "N"),)


def settle_time(force, *, below, noise_n, seed=0, timeout_s=120.0, poll_s=0.1, hold_s=HOLD_S):
    """Feed a force as it would come in; return when the bench counts as at rest, or None."""
    rng = np.random.default_rng(seed)
    detector = SettleDetector(WATCHED, Bounds((below,), (below,)), hold_s, 0.0)
    per_poll = round(poll_s * RATE_HZ)
    for k in range(int(timeout_s / poll_s)):
        times = (k * per_poll + np.arange(per_poll)) / RATE_HZ
        values = force(times) + noise_n * rng.standard_normal(per_poll)
        if detector.feed({"cell": Samples(times, times, values[:, None])}, (k + 1) * poll_s):
            return (k + 1) * poll_s
    return None


@given(noise_n=st.floats(0.0, 0.5), offset=st.floats(-50, 50), seed=st.integers(0, 2**20))
@settings(max_examples=40, deadline=None)
def test_noise_alone_however_strong_counts_as_rest(noise_n, offset, seed):
    time = settle_time(lambda t: offset + 0 * t, below=0.02, noise_n=noise_n, seed=seed, timeout_s=60)
    assert time is not None
    assert time >= 2 * HOLD_S - 1e-9


@given(
    amplitude_n=st.floats(0.3, 5.0),
    decay_s=st.floats(1.5, 10.0),
    frequency_hz=st.floats(0.1, 1.0),
    phase=st.floats(0, 2 * np.pi),
    noise_n=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**20),
)
@settings(max_examples=80, deadline=None)
def test_a_dying_wave_is_waited_for_until_little_of_it_is_left(
    amplitude_n, decay_s, frequency_hz, phase, noise_n, seed
):
    below = 0.05

    def wave(t):
        return amplitude_n * np.exp(-t / decay_s) * np.cos(2 * np.pi * frequency_hz * t + phase)

    time = settle_time(wave, below=below, noise_n=noise_n, seed=seed)
    assert time is not None
    left_n = amplitude_n * np.exp(-(time - HOLD_S) / decay_s)
    # What a window cannot resolve beyond its noise, it cannot see: 200 samples of this noise.
    assert left_n < 5 * (below + 0.5 * noise_n)
    # And it does not wait for ever either.
    quiet_s = decay_s * np.log(amplitude_n / (0.25 * below))
    assert time < quiet_s + 4 * HOLD_S + 2.0


@given(phase=st.floats(0, 2 * np.pi), frequency_hz=st.floats(0.1, 1.0), seed=st.integers(0, 2**20))
@settings(max_examples=40, deadline=None)
def test_a_steady_wave_not_far_above_the_noise_of_single_samples_is_never_taken_for_rest(
    phase, frequency_hz, seed
):
    time = settle_time(
        lambda t: 0.2 * np.cos(2 * np.pi * frequency_hz * t + phase),
        below=0.02,
        noise_n=0.1,
        seed=seed,
        timeout_s=40,
    )
    assert time is None


def test_a_slow_ramp_is_drift():
    assert settle_time(lambda t: 0.05 * t, below=0.02, noise_n=0.05, timeout_s=60) is None


def test_one_wild_sample_does_not_restart_settling():
    def glitch(t):
        return np.where(np.abs(t - 3.0) < 0.004, 20.0, 0.0)

    time = settle_time(glitch, below=0.02, noise_n=0.01)
    assert time == pytest.approx(2 * HOLD_S, abs=0.5)


def test_a_step_in_the_force_does_restart_settling():
    time = settle_time(lambda t: np.where(t > 3.0, 1.0, 0.0), below=0.02, noise_n=0.01)
    assert time > 3.0 + 2 * HOLD_S - 0.3


@given(st.floats(0.05, 5.0), st.floats(0.5, 4.0))
@settings(max_examples=30, deadline=None)
def test_without_noise_spread_and_drift_are_those_of_the_signal(slope, length_s):
    times = np.arange(int(length_s * 200)) / 200.0
    assume(len(times) >= 40)
    result = stillness(times, (slope * times)[:, None])
    assert result.drift[0] == pytest.approx(slope * length_s, rel=0.05)
    assert result.spread[0] == pytest.approx(slope * length_s / np.sqrt(12), rel=0.15)


def test_too_few_samples_give_no_judgement():
    assert stillness(np.arange(8.0), np.zeros((8, 1))) is None


def test_the_baseline_of_a_noisy_bench_is_at_least_what_noise_lets_one_see():
    rng = np.random.default_rng(3)
    meter = BaselineMeter(WATCHED, HOLD_S)
    for k in range(150):
        times = (k * 10 + np.arange(10)) / RATE_HZ
        meter.feed({"cell": Samples(times, times, 0.1 * rng.standard_normal((10, 1)))}, (k + 1) * 0.1)
    bounds = meter.bounds()
    assert 0.005 < bounds.spread[0] < 0.05
    assert 0.005 < bounds.drift[0] < 0.2


def test_a_bench_that_never_rests_is_gone_on_with_after_the_cap_and_the_reason_is_stored(lab):
    lab = lab(
        rig__scene={"plugin": "pond:Pond", "echo_n": 50.0, "decay_s": 1e6},
        trial__settle__timeout_s=8,
        trial__repeats=2,
    )
    (result,) = lab.session.measure([{"a": 10, "f": 1.0}])
    second = result.outcomes[1]
    assert second.status == "done"
    assert second.settle.reason == "timeout"
    assert second.settle.duration_s == pytest.approx(8.0)
    assert second.settle.spread > second.settle.bound


def test_a_trial_that_did_not_settle_is_rejected_where_the_file_says_so(lab):
    lab = lab(
        rig__scene={"plugin": "pond:Pond", "echo_n": 50.0, "decay_s": 1e6},
        trial__settle__timeout_s=8,
        trial__settle__on_timeout="reject",
        trial__repeats=1,
    )
    (first, second) = lab.session.measure([{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}])
    rejected = [o for m in (first, second) for o in m.outcomes if o.status == "rejected"]
    assert rejected
    assert "not at rest after 8 s: cell.force_x" in rejected[0].reason


def test_a_dying_echo_is_waited_for(lab):
    still = lab(rig__scene={"plugin": "pond:Pond"}).session.measure([{"a": 20, "f": 1.0}])
    assert still[0].outcomes[1].settle.duration_s == pytest.approx(2.0, abs=0.6)


def test_an_echoing_bench_takes_longer_to_settle_than_a_quiet_one(lab):
    result = lab(rig__scene={"plugin": "pond:Pond", "echo_n": 2.0}).session.measure([{"a": 20, "f": 1.0}])
    assert result[0].outcomes[1].settle.reason == "quiet"
    assert result[0].outcomes[1].settle.duration_s > 4.0


def test_without_a_bound_the_benchs_own_baseline_is_the_bound_and_is_journalled(lab):
    lab = lab(trial__settle__below=None, rig__devices__cell__noise_n=0.1)
    result = lab.session.measure([{"a": 10, "f": 1.0}])
    events = [event for event in lab.folder.journal.events() if event["event"] == "baseline"]
    assert len(events) == 1
    assert result[0].outcomes[0].settle.bound == pytest.approx(1.5 * events[0]["spread"][0])
    assert result[0].outcomes[0].settle.reason == "quiet"
