"""The caudal tank: published best gait and step responses, and a memory that spoils a trial that does not wait."""

import numpy as np
import pytest
from labrun_plugins.rigs.caudal_fin.scene import CaudalTank
from scipy.optimize import curve_fit
from simulated_bench import line, sine

FORCES = ["force_x", "force_y"]


def _tank(noise=0.0, seed=0, **settings):
    tank = CaudalTank({"noise": noise, **settings}, np.random.default_rng(seed))
    tank.observe(FORCES, np.array([0.0]))
    return tank


def _trial(tank, start_s, amplitude_deg, frequency_hz, *, offset_deg=0.0, cycles=6, discard=2):
    """Return mean forward and side force over whole cycles."""
    end_s = cycles / frequency_hz
    tank.drive("tail", sine("tail", amplitude_deg, frequency_hz, end_s, offset_deg=offset_deg), start_s)
    time_s = start_s + np.arange(discard / frequency_hz, end_s, 0.01)
    return tank.observe(FORCES, time_s).mean(axis=0), start_s + end_s


def _rest(tank, from_s):
    tank.drive("tail", line("tail", [0.0], [0.0]), from_s)


def test_the_best_gait_of_a_coarse_scan_is_the_published_one_and_most_gaits_push_backwards():
    scan = [
        (
            _trial(
                _tank(), 1.0, a, f, offset_deg=b, cycles=max(6, round(4 * f)), discard=max(2, round(2 * f))
            )[0][0],
            a,
            b,
            f,
        )
        for b in (-20, 0, 20)
        for a in (20, 40, 60)
        for f in np.arange(0.2, 3.01, 0.4)
        if a + abs(b) <= 60 and a * f <= 84.01
    ]
    thrust, a, b, f = max(scan)
    assert (a, b) == (60, 0)
    assert f == pytest.approx(1.4)
    assert thrust == pytest.approx(0.547, rel=0.03)
    assert np.mean([pair[0] < 0 for pair in scan]) > 0.5


@pytest.mark.parametrize("amplitude_deg", [20, 40, 60])
def test_thrust_is_the_published_gain_times_amplitude(amplitude_deg):
    (forward, side), _ = _trial(_tank(), 1.0, amplitude_deg, 1.4, cycles=14, discard=6)
    assert forward == pytest.approx(0.00912 * amplitude_deg, rel=0.02)
    assert side == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize("offset_deg", [-20, -10, 10])
def test_an_offset_turns_the_force_by_the_published_gain(offset_deg):
    (forward, side), _ = _trial(_tank(), 1.0, 40, 1.4, offset_deg=offset_deg, cycles=14, discard=6)
    assert np.degrees(np.arctan2(side, forward)) == pytest.approx(-0.866 * offset_deg, abs=0.3)


def _fopdt(time_s, gain, lag_s, dead_s):
    return gain * np.where(time_s > dead_s, 1 - np.exp(-np.maximum(time_s - dead_s, 0) / lag_s), 0)


def test_an_amplitude_step_shows_the_published_gain_lag_and_dead_time():
    time_s = np.arange(-1.0, 8.0, 0.005)
    cycle = np.ones(143) / 143

    def averaged(values):
        return np.convolve(values, cycle, "valid")  # over one cycle, measurement and model alike

    def response(_, gain, lag_s, dead_s):
        return averaged(_fopdt(time_s, gain, lag_s, dead_s))

    results = []
    for seed in range(8):
        tank = _tank(noise=1.0, seed=seed)
        tank.drive("tail", sine("tail", 40, 1.4, 10.0), 2.0)
        force = averaged(tank.observe(["force_x"], 2.0 + time_s)[:, 0])
        results.append(curve_fit(response, time_s, force, p0=[0.3, 0.3, 0.2])[0])
    mean = np.mean(results, axis=0)
    uncertain = 3 * np.std(results, axis=0, ddof=1) / np.sqrt(len(results))
    np.testing.assert_array_less(
        np.abs(mean - [0.00912 * 40, 0.34, 0.28]), uncertain + np.array([0.005, 0.03, 0.04])
    )


def test_force_oscillates_at_the_stroke_s_frequency_sideways_and_at_twice_forward():
    tank = _tank()
    tank.drive("tail", sine("tail", 40, 1.4, 30.0), 1.0)
    time_s = 11.0 + np.arange(0.0, 14 / 1.4, 0.005)
    force = tank.observe(FORCES, time_s)
    spectrum = np.abs(np.fft.rfft(force - force.mean(axis=0), axis=0))
    assert [int(np.argmax(column)) for column in spectrum.T] == [28, 14]  # periods of 14 cycles


def test_the_sensor_above_feels_force_times_bar():
    tank = _tank(bar_length_m=0.3)
    tank.drive("tail", sine("tail", 40, 1.4, 5.0), 1.0)
    time_s = np.arange(1.0, 6.0, 0.01)
    values = tank.observe(["force_x", "force_y", "torque_x", "torque_y"], time_s)
    np.testing.assert_allclose(values[:, 2], 0.3 * values[:, 1], atol=1e-12)
    np.testing.assert_allclose(values[:, 3], -0.3 * values[:, 0], atol=1e-12)


def test_a_trial_that_does_not_wait_is_spoiled_by_several_standard_errors():
    settled, hasty = [], []
    for seed in range(12):
        tank = _tank(noise=1.0, seed=seed)
        _, end_s = _trial(tank, 1.0, 60, 1.4)
        _rest(tank, end_s)
        second, end_s = _trial(tank, end_s + 0.8, 30, 1.4)
        hasty.append(second[0])
        _rest(tank, end_s)
        third, _ = _trial(tank, end_s + 30.0, 30, 1.4)
        settled.append(third[0])
    standard_error = np.std(settled, ddof=1) / np.sqrt(len(settled))
    assert np.mean(settled) == pytest.approx(0.00912 * 30, abs=4 * standard_error)
    assert abs(np.mean(hasty) - np.mean(settled)) > 4 * standard_error


def test_after_a_trial_the_water_comes_to_rest_within_a_minute():
    tank = _tank(noise=1.0, seed=3)
    _, end_s = _trial(tank, 1.0, 60, 1.4)
    _rest(tank, end_s)
    soon = tank.observe(["force_x"], end_s + np.arange(1.0, 3.0, 0.01))
    late = tank.observe(["force_x"], end_s + np.arange(40.0, 42.0, 0.01))
    assert np.abs(soon).max() > 0.05
    assert np.abs(late).max() < 0.005


def test_a_hidden_delay_of_the_servo_shifts_the_joint():
    plain, hidden = (
        _tank(),
        _tank(hide=[{"effect": "delay", "site": "tail", "values": {"delay": 0.1}}]),
    )
    time_s = np.arange(1.5, 4.0, 0.01)
    angles = []
    for tank in (plain, hidden):
        tank.drive("tail", sine("tail", 30, 1.0, 5.0), 1.0)
        angles.append(tank.observe(["tail"], time_s)[:, 0])
    np.testing.assert_allclose(angles[0], np.radians(30) * np.sin(2 * np.pi * (time_s - 1.0)), atol=0.001)
    np.testing.assert_allclose(angles[1], np.radians(30) * np.sin(2 * np.pi * (time_s - 1.1)), atol=0.001)
