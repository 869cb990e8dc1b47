"""Controllers from a fitted response: rules, margins, optimum, predictions, and what is written for people."""

import json
import math
import tomllib
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from labrun.app.fit import fit
from labrun.app.run import run as execute
from labrun.control import HalfSineSettings
from labrun.control.pid import FeedforwardPid, PidController
from labrun.control.protocol import LoopContext, Step
from labrun.errors import FitError, RequestError
from labrun.estimate import Estimate
from labrun.experiment import load_named
from labrun.fit.result import FitSummary, FittedData
from labrun.fit.transfer import TransferFunction
from labrun.fit.transfer.method import TransferSummary
from labrun.fit.tuning.designs import ControllerDesign, Study, study
from labrun.fit.tuning.loop import Gains, OpenLoop, margins, ultimate
from labrun.fit.tuning.method import FittedPlant, plant_of, summary
from labrun.fit.tuning.optimum import loop_error, optimum
from labrun.fit.tuning.response import run_loop
from labrun.fit.tuning.settings import PidFitSettings
from labrun.fit.tuning.simc import Reduced, reduce_order, rules, simc
from labrun.fit.tuning.summary import shown_designs

CYCLE_S = 1 / 1.4
GAIN = 0.00912
UNITS = {"input_name": "a", "output_name": "force", "input_unit": "deg", "output_unit": "N"}
MAGNITUDE = TransferFunction.first_order(GAIN, 0.34, 0.28, **UNITS)  # (5.5)
ANGLE = TransferFunction.first_order(-0.866, 0.13, 0.12)  # (5.6)
BENCH = OpenLoop(MAGNITUDE, 20.0, 0.0, CYCLE_S)


def product(*factors):
    result = np.array([1.0])
    for factor in factors:
        result = np.polymul(result, factor)
    return tuple(result)


plants = st.builds(
    TransferFunction.first_order,
    gain=st.floats(0.01, 100.0).flatmap(lambda size: st.sampled_from([size, -size])),
    lag_s=st.floats(0.05, 5.0),
    dead_s=st.floats(0.05, 2.0),
)

averages = st.one_of(st.just(0.0), st.floats(0.05, 1.0))

# --- SIMC against Skogestad (2003)


def test_the_half_rule_reduces_the_published_examples():
    # E1: 1/((s+1)(0.2s+1))
    first = reduce_order(TransferFunction((1.0,), product([1, 1], [0.2, 1])), 1)
    assert (first.lag_s, first.dead_s) == pytest.approx((1.1, 0.1))
    # E2: (-0.3s+1)(0.08s+1) / ((2s+1)(s+1)(0.4s+1)(0.2s+1)(0.05s+1)^3)
    second = TransferFunction(
        product([-0.3, 1], [0.08, 1]),
        product([2, 1], [1, 1], [0.4, 1], [0.2, 1], [0.05, 1], [0.05, 1], [0.05, 1]),
    )
    order, two = reduce_order(second, 1), reduce_order(second, 2)
    assert (order.lag_s, order.dead_s) == pytest.approx((2.5, 1.47), rel=1e-3)
    assert (two.lag_s, two.second_lag_s, two.dead_s) == pytest.approx((2.0, 1.2, 0.77), rel=1e-3)
    # E3: 2(15s+1)/((20s+1)(s+1)(0.1s+1)^2)
    third = TransferFunction(product([2.0], [15, 1]), product([20, 1], [1, 1], [0.1, 1], [0.1, 1]))
    order, two = reduce_order(third, 1), reduce_order(third, 2)
    assert (order.gain, order.lag_s, order.dead_s) == pytest.approx((1.5, 1.05, 0.15), rel=1e-3)
    assert (two.gain, two.lag_s, two.second_lag_s, two.dead_s) == pytest.approx(
        (1.5, 1, 0.15, 0.05), rel=1e-3
    )


def test_the_rules_give_the_published_gains():
    pi = rules(Reduced(1.0, 1.1, 0.0, 0.1), "PI")
    assert (pi.p, pi.p / pi.i_per_s) == pytest.approx((5.5, 0.8))
    pi = rules(Reduced(1.0, 2.5, 0.0, 1.47), "PI")
    assert (pi.p, pi.p / pi.i_per_s) == pytest.approx((0.85, 2.5), rel=1e-2)
    # series form 1.30, 2, 1.2, as parallel gains
    pid = rules(Reduced(1.0, 2.0, 1.2, 0.77), "PID")
    assert (pid.p, pid.i_per_s, pid.d_s) == pytest.approx((1.3 * 1.6, 1.3 / 2, 1.3 * 1.2), rel=1e-2)


def test_a_first_order_plant_gets_a_third_of_the_dead_time_as_derivative_time():
    pid = rules(Reduced(2.0, 1.0, 0.0, 0.3), "PID")
    series = 1.0 / (2.0 * 0.6)
    assert (pid.p, pid.i_per_s, pid.d_s) == pytest.approx((series * 1.1, series, series * 0.1))


def test_a_plant_without_a_lag_gets_an_integral_alone():
    pi = rules(Reduced(2.0, 0.0, 0.0, 0.5), "PI")
    assert (pi.p, pi.i_per_s) == (0.0, pytest.approx(0.5))


def test_sampling_and_averaging_count_as_dead_time():
    assert BENCH.delay_s == pytest.approx(0.28 + 0.025 + 0.5 * CYCLE_S)
    assert simc(BENCH, "PI").p == pytest.approx(0.34 / (GAIN * 2 * BENCH.delay_s))


def test_swinging_plants_are_refused_by_the_half_rule_and_said_so():
    with pytest.raises(FitError, match="complex poles"):
        simc(OpenLoop(TransferFunction((1.0,), (1.0, 0.2, 1.0)), 20.0), "PI")


# --- margins


@given(st.floats(0.2, 20.0), st.floats(0.1, 10.0), st.floats(0.05, 2.0))
@settings(max_examples=25, deadline=None)
def test_margins_are_those_of_python_control_without_dead_time(p, i_per_s, lag_s):
    plant = TransferFunction((3.0,), product([lag_s, 1], [0.4, 1], [0.1, 1]))
    result = margins(Gains(p, i_per_s), OpenLoop(plant))
    s = control.tf("s")
    open_loop = (p + i_per_s / s) * control.tf(plant.numerator, plant.denominator)
    gain, phase, _, omega_pc, omega_gc, _ = control.stability_margins(open_loop)
    closed = control.feedback(open_loop, 1)
    assert result.stable == bool(np.all(closed.poles().real < 0))
    assert result.gain == pytest.approx(gain, rel=1e-4)
    assert result.phase_crossover_rad_s == pytest.approx(omega_pc, rel=1e-4)
    if result.stable:
        assert result.phase_deg == pytest.approx(phase, abs=1e-3)
        assert result.crossover_rad_s == pytest.approx(omega_gc, rel=1e-4)
        assert result.delay_s == pytest.approx(math.radians(phase) / omega_gc, rel=1e-4)


def test_an_integral_on_a_dead_time_has_the_margins_of_the_closed_form():
    # L = k exp(-s)/s: crossover k, phase 90 deg - k, oscillates at pi/2 with k = pi/2
    loop = OpenLoop(TransferFunction((1.0,), (1.0,), 1.0))
    result = margins(Gains(0.0, 0.5), loop)
    assert result.gain == pytest.approx(math.pi, rel=1e-6)
    assert result.phase_deg == pytest.approx(90 - math.degrees(0.5), rel=1e-6)
    assert result.delay_s == pytest.approx((math.pi / 2 - 0.5) / 0.5, rel=1e-6)
    assert result.crossover_rad_s == pytest.approx(0.5, rel=1e-6)


@given(plants, st.sampled_from([None, 20.0, 50.0]), st.floats(0.0, 1.0))
@settings(max_examples=15, deadline=None)
def test_a_crossover_on_a_frequency_of_the_grid_is_found(plant, rate_hz, share):
    loop = OpenLoop(plant, rate_hz)
    shape = Gains(math.copysign(1.0, plant.gain), i_per_s=1.0 / plant.gain)
    curve = shape.frequency_response(loop.grid_rad_s, loop.step_s) * loop.grid_response
    index = 10 + round(share * (len(curve) // 2))
    result = margins(shape.scaled(1.0 / abs(curve[index])), loop)
    assert result.crossover_rad_s >= loop.grid_rad_s[index] * (1 - 1e-6)
    assert result.phase_deg <= abs(math.degrees(np.angle(-curve[index]))) + 1e-3


@given(
    st.floats(0.2, 2.0),
    st.floats(0.2, 1.0),
    st.sampled_from([None, 20.0]),
    averages,
    st.floats(0.05, 3.0),
    st.floats(0.0, 2.0),
)
@settings(max_examples=10, deadline=None)
def test_margins_are_those_of_a_much_denser_curve(lag_s, dead_s, rate_hz, average_s, share, integral):
    plant = TransferFunction.first_order(-2.0, lag_s, dead_s)
    loop = OpenLoop(plant, rate_hz, average_s=average_s)
    gains = Gains(share / plant.gain, integral / plant.gain / (plant.lag_s + loop.delay_s))
    result = margins(gains, loop)
    omega = np.linspace(0, min(30.0, np.pi * (rate_hz or np.inf)), 10_001)[1:]
    curve = gains.frequency_response(omega, loop.step_s) * loop.frequency_response(omega)
    negative = np.flatnonzero((np.diff(np.sign(curve.imag)) != 0) & (curve.real[:-1] < 0))
    if len(negative):
        assert 1.0 / result.gain == pytest.approx(np.max(np.abs(curve[negative])), rel=1e-2)
    unit = np.flatnonzero(np.diff(np.sign(np.abs(curve) - 1)) != 0)
    angles = np.abs(np.degrees(np.angle(-curve[unit])))
    assert (len(unit) == 0) == math.isinf(result.phase_deg)
    assert len(unit) == 0 or result.phase_deg == pytest.approx(np.min(angles), abs=1.0)
    assert 1.0 / result.sensitivity == pytest.approx(np.min(np.abs(1 + curve)), abs=1e-2)


def test_an_optimum_bounded_by_its_phase_margin_has_that_phase_margin():
    loop = OpenLoop(TransferFunction.first_order(3.11, 2.88, 0.654), 50.0)
    result = margins(optimum(loop, "PI", PidFitSettings(phase_margin_deg=45.0)), loop)
    assert result.phase_deg == pytest.approx(45.0, abs=0.5)
    assert result.delay_s == pytest.approx(math.radians(result.phase_deg) / result.crossover_rad_s)


def test_ultimate_gains_of_the_fin_are_the_published_ones():
    gain, omega = ultimate(OpenLoop(MAGNITUDE))
    assert (gain, omega) == (pytest.approx(284, abs=0.5), pytest.approx(7.0, abs=0.05))
    gain, omega = ultimate(OpenLoop(MAGNITUDE, average_s=CYCLE_S))
    assert (gain, omega) == (pytest.approx(228, abs=0.5), pytest.approx(3.55, abs=0.01))
    assert ultimate(OpenLoop(ANGLE))[0] == pytest.approx(-2.76, abs=0.005)


def test_a_fast_loop_comes_to_the_continuous_one():
    fast, slow = (
        ultimate(OpenLoop(MAGNITUDE, 1000.0, 0.0, CYCLE_S)),
        ultimate(OpenLoop(MAGNITUDE, average_s=CYCLE_S)),
    )
    assert fast == pytest.approx(slow, rel=2e-3)


@given(plants, st.floats(2.0, 50.0), averages, st.floats(0.0, 0.2))
@settings(max_examples=20, deadline=None)
def test_the_response_of_samples_is_the_sum_of_its_aliases(plant, rate_hz, average_s, compute_s):
    loop = OpenLoop(plant, rate_hz, compute_s, average_s)
    omega = np.array([0.05, 0.3, 0.7]) * np.pi * rate_hz
    bands = omega[:, None] + 2 * np.pi * rate_hz * np.arange(-3000, 3001)
    held = np.exp(-0.5j * bands / rate_hz) * np.sinc(bands / (2 * np.pi * rate_hz))
    seen = np.exp(-0.5j * bands * average_s) * np.sinc(bands * average_s / (2 * np.pi))
    expected = (held * seen * plant.frequency_response(bands) * np.exp(-1j * bands * compute_s)).sum(axis=1)
    assert loop.frequency_response(omega) == pytest.approx(expected, rel=2e-3, abs=2e-4 * abs(plant.gain))


def test_the_loop_oscillates_in_time_at_the_gain_that_the_curve_says():
    limit = ultimate(BENCH)[0]

    def end_over_middle(share):
        track = run_loop(Gains(share * limit), BENCH, lambda _: 1.0, 60.0)
        swing = track.output - np.mean(track.output[-100:])
        return np.ptp(swing[-100:]) / np.ptp(swing[400:500])

    assert end_over_middle(0.97) < 0.8
    assert end_over_middle(1.03) > 1.25


def test_a_controller_that_drives_the_wrong_way_is_not_called_stable():
    assert not margins(Gains(0.0, -1.0), BENCH).stable
    assert not margins(Gains(-1.5 / GAIN), BENCH).stable


# --- the optimum


@given(
    plants,
    st.sampled_from(["P", "PI", "PID"]),
    st.floats(1.5, 4.0),
    st.floats(30.0, 70.0),
    st.sampled_from([None, 1.6, 2.2]),
    st.one_of(st.just(0.0), st.floats(0.05, 1.0)),
)
@settings(max_examples=8, deadline=None)
def test_an_optimum_keeps_the_margins_that_were_asked_for(plant, structure, gain, phase_deg, most, average_s):
    loop = OpenLoop(plant, 20.0, 0.0, average_s)
    wanted = PidFitSettings(gain_margin=gain, phase_margin_deg=phase_deg, max_sensitivity=most)
    result = margins(optimum(loop, structure, wanted), loop)
    assert result.stable
    assert result.gain >= gain
    assert result.phase_deg >= phase_deg
    assert most is None or result.sensitivity <= most


def test_an_optimum_has_less_error_than_simc_and_than_its_neighbours():
    wanted = PidFitSettings()
    best = optimum(BENCH, "PI", wanted)
    least = loop_error(BENCH, best, wanted)
    assert least < loop_error(BENCH, simc(BENCH, "PI"), wanted)
    for factor_p, factor_i in ((0.9, 1.0), (1.1, 1.0), (1.0, 0.9), (1.0, 1.1)):
        other = Gains(best.p * factor_p, best.i_per_s * factor_i)
        assert loop_error(BENCH, other, wanted) > 0.9999 * least


def test_the_error_of_the_optimum_is_the_one_that_a_simulation_finds():
    gains = optimum(BENCH, "PI", PidFitSettings())
    step = run_loop(gains, BENCH, lambda _: 1.0, 30.0)
    load = run_loop(gains, BENCH, lambda _: 0.0, 30.0, load=lambda _: 1.0 / GAIN)
    area = (np.sum(np.abs(1.0 - step.output)) + np.sum(np.abs(load.output))) * BENCH.step_s
    assert loop_error(BENCH, gains, PidFitSettings()) * (BENCH.delay_s + 0.34) == pytest.approx(
        area, rel=0.01
    )


def test_a_plant_that_does_not_settle_is_refused():
    with pytest.raises(FitError, match="right half plane or at 0"):
        optimum(OpenLoop(TransferFunction((1.0,), (1.0, 0.0), 0.1), 20.0), "PI", PidFitSettings())


# --- the closed loop in time


def euler_step(p, i_per_s, loop, lag_s, dead_s, gain, duration_s, h=1e-4):
    """A fine Euler integration with buffers for the dead time and the mean: its own code, no matrix exponential."""
    steps, hold, dead = round(duration_s / h), round(loop.step_s / h), round((dead_s + loop.compute_s) / h)
    mean = round(loop.average_s / h)
    drives, outputs = np.zeros(steps + 1), np.zeros(steps + 1)
    total = np.zeros(steps + 2)
    y = integral = drive = 0.0
    for k in range(steps + 1):
        outputs[k] = y
        total[k + 1] = total[k] + y
        if k % hold == 0:
            seen = (total[k] - total[max(k - mean, 0)]) / mean if mean else y
            integral += i_per_s * (1.0 - seen) * loop.step_s
            drive = p * (1.0 - seen) + integral
        drives[k] = drive
        pushed = drives[k - dead] if k >= dead else 0.0
        y += h * (gain * pushed - y) / lag_s
    return outputs[::hold], drives[::hold]


@pytest.mark.parametrize("average_s", [0.0, CYCLE_S])
def test_a_predicted_step_is_that_of_an_independent_integration(average_s):
    loop = OpenLoop(MAGNITUDE, 20.0, 0.013, average_s)
    gains = Gains(50.0, 90.0)
    track = run_loop(gains, loop, lambda _: 1.0, 5.0)
    output, drive = euler_step(50.0, 90.0, loop, 0.34, 0.28, GAIN, 5.0)
    assert track.output == pytest.approx(output, abs=2e-3)
    assert track.drive == pytest.approx(drive, abs=0.3)


def test_the_dead_time_is_exact_to_the_sample():
    track = run_loop(Gains(50.0), OpenLoop(MAGNITUDE, 100.0), lambda _: 1.0, 1.0)
    assert np.all(track.output[track.time_s < 0.2801] == pytest.approx(0.0, abs=1e-12))
    assert track.output[29] == pytest.approx(50.0 * GAIN * (1 - math.exp(-0.01 / 0.34)), rel=1e-9)


def test_a_loop_that_begins_at_rest_stays_there():
    reference = GAIN * 30.0
    track = run_loop(Gains(0.0, 40.0), BENCH, lambda _: reference, 10.0, start=30.0, bounds=(20.0, 60.0))
    # the integral of the plugin starts empty, the plant does not
    assert track.output[0] == pytest.approx(reference)
    assert track.feedback[0] == pytest.approx(reference)
    assert np.min(track.drive) >= 20.0


@given(plants, st.floats(0.1, 0.9))
@settings(max_examples=15, deadline=None)
def test_proportional_control_keeps_one_over_one_plus_the_loop_gain(plant, share):
    loop = OpenLoop(plant, 20.0)
    gains = Gains(share * 0.5 * ultimate(loop)[0])
    expected = gains.steady_error(loop.gain)
    assert expected == pytest.approx(1 / (1 + gains.p * plant.gain))
    track = run_loop(gains, loop, lambda _: 1.0, 60.0 * (plant.dead_s + plant.lag_s + 0.1))
    assert 1.0 - track.output[-1] == pytest.approx(expected, abs=1e-2)


def test_at_109_6_deg_per_newton_half_of_the_reference_is_missing():
    assert Gains(109.6).steady_error(GAIN) == pytest.approx(0.5, abs=1e-3)


def test_the_gains_of_table_5_4_do_in_the_prediction_what_the_source_says():
    """Section 5.4's simulated errors: reference 0.18-0.45 N, drive 20-60 deg, 20 Hz, mean over a cycle."""
    reference, bounds = HalfSineSettings(low=0.18, high=0.45, period_s=100.0), (20.0, 60.0)
    factors = (0.85, 1.0, 1.15)

    def errors(p, i_per_s=0.0, feedforward=None):
        return ControllerDesign("x", "given", Gains(p, i_per_s, feedforward=feedforward), BENCH).errors(
            reference, bounds, factors
        )

    assert errors(109.0)[1.0] == pytest.approx((0.16, 0.16), abs=0.01)
    assert errors(80.0, 0.12)[1.0] == pytest.approx((0.17, 0.16), abs=0.01)
    assert errors(80.0, 0.12 * 20)[1.0] == pytest.approx((0.11, 0.05), abs=0.01)
    ff_p = errors(10.9, feedforward=1 / GAIN)
    assert ff_p[1.0] == pytest.approx((0.004, 0.003), abs=0.002)
    assert ff_p[0.85] == pytest.approx((0.05, 0.05), abs=0.005)
    assert errors(9.0, 0.05 * 20, 1 / GAIN)[0.85] == pytest.approx((0.035, 0.019), abs=0.004)


# --- what people get


TABLE_5_4 = {
    "P-109": {"p": 109},
    "PI": {"p": 80, "i": 0.12, "i_per": "sample"},
    "FF-P": {"p": 10.9, "feedforward": True},
    "FF-PI": {"p": 9, "i": 0.05, "i_per": "sample", "feedforward": True},
}


def pulse_response(plant, count):
    """The samples after a drive of 1 for one step."""
    response = np.zeros(count)
    for tap in plant.taps:
        response[tap.whole] += tap.from_drive
        state = plant.input
        for k in range(tap.whole + 1, count):
            response[k] += tap.from_state @ state
            state = plant.transition @ state
    return response


def summary_of(result: Study, others=()):
    return summary(
        FittedPlant("magnitude", MAGNITUDE, FittedData("fin-step", "run", 3), tuple(others)), result
    )


@pytest.fixture(scope="module")
def fin() -> Study:
    keys = {
        "range": [20, 59],
        "reference": {"low": 0.18, "high": 0.45, "period_s": 100},
        "compare": TABLE_5_4,
        "i_per": "sample",
    }
    others = [
        TransferFunction.first_order(GAIN * (1 + 0.02 * k), 0.34, 0.28 * (1 - 0.02 * k), **UNITS)
        for k in range(-3, 4)
    ]
    return study(MAGNITUDE, others, PidFitSettings.model_validate(keys), CYCLE_S)


def test_chapter_fives_verdict_comes_out(fin):
    text = " ".join(summary_of(fin).to_text(10_000).split())
    assert "P-109 leaves 50% of the reference" in text
    assert "PI misses the first arch and follows afterwards" in text
    assert "FF-P follows from the first arch" in text
    assert "it stays off for good" in text
    assert "FF-PI follows from the first arch" in text
    best = fin.named(fin.best)
    assert best.structure == "FF-PI"
    assert best.source != "given"
    given_errors = {
        design.name: sum(fin.errors[design.name][0.85]) for design in fin.designs if design.source == "given"
    }
    assert min(given_errors, key=given_errors.get) == "FF-PI"


def test_the_toml_file_makes_controllers_that_do_what_was_predicted(fin):
    tables = tomllib.loads(summary_of(fin).files["pid.toml"])["track"]["loops"]["force"]["controllers"]
    assert set(tables) == {design.name for design in fin.designs if design.source != "given"}
    plugins = {"pid": PidController, "feedforward+pid": FeedforwardPid}
    for name, table in tables.items():
        keys = dict(table)
        plugin = plugins[keys.pop("plugin")]
        controller = plugin(keys, LoopContext(0.05, -1e9, 1e9, 0.0))
        predicted = fin.named(name).step
        # the plant by convolution with its sampled pulse, apart from the stepper
        pulse = pulse_response(fin.loop.sampled, 200)
        drives = np.zeros(200)
        for k in range(200):
            seen = float(pulse[1 : k + 1] @ drives[:k][::-1]) if k else 0.0
            drives[k] = controller.update(Step(0.05 * k, 0.05, 1.0, seen, 0.0, lambda _: 1.0))
            controller.applied(drives[k])
        count = min(200, len(predicted.drive))
        assert drives[:count] == pytest.approx(predicted.drive[:count], rel=2e-3, abs=0.2)


def test_an_integral_per_sample_is_the_rate_th_of_one_per_second(fin):
    tables = tomllib.loads(summary_of(fin).files["pid.toml"])["track"]["loops"]["force"]["controllers"]
    design = fin.named("pi-simc")
    assert tables["pi-simc"]["i_per"] == "sample"
    assert tables["pi-simc"]["i"] == pytest.approx(design.gains.i_per_s / 20, rel=1e-4)


def test_a_margin_lost_within_the_fits_interval_is_told_and_the_design_not_taken():
    others = [TransferFunction.first_order(GAIN * factor, 0.34, 0.28) for factor in np.linspace(0.3, 3.0, 40)]
    keys = {"structure": "P", "method": "optimum", "feedforward": False}
    result = study(MAGNITUDE, others, PidFitSettings.model_validate(keys), CYCLE_S)
    message = " ".join(summary_of(result, others).warnings)
    assert "p-optimum may lose its margin within the fit's 95 % interval" in message
    assert result.best is None
    assert "none is recommended" in message


@pytest.mark.parametrize("structure", ["P", "PI", "all"])
@pytest.mark.parametrize("plant", [MAGNITUDE, ANGLE, TransferFunction.first_order(2.0, 3.0, 0.1)])
def test_without_a_reference_no_design_is_taken_that_overshoots_a_step_by_a_quarter(plant, structure):
    result = study(plant, (), PidFitSettings(structure=structure), CYCLE_S)
    # there are such designs, and the least error is that of one of them or near it
    assert any(design.figures.overshoot > 0.25 for design in result.designs) or structure != "all"
    assert result.best is None or result.named(result.best).figures.overshoot <= 0.25


def test_where_every_design_overshoots_a_step_it_is_said_why_none_is_taken():
    keys = PidFitSettings(structure="P", method="optimum", feedforward=False, gain_margin=1.5)
    result = study(MAGNITUDE, (), keys, CYCLE_S)
    assert result.best is None
    assert any("overshooting a step by more than 25%" in warning for warning in summary_of(result).warnings)


def test_margins_that_cannot_be_lost_are_none_and_have_no_interval(fin):
    margins_ = next(table for table in summary_of(fin).tables if table.title.startswith("margins"))
    row = next(candidate for candidate in margins_.rows if candidate[0] == "p-simc")
    assert row[3:6] == ("none", "", "none")
    assert not any("inf ... inf" in cell for row in margins_.rows for cell in row)


def test_the_picture_shows_the_recommended_design_those_of_the_file_and_then_the_best(fin):
    assert [design.name for design in shown_designs(fin)] == [fin.best, *TABLE_5_4]
    few = replace(fin, designs=tuple(design for design in fin.designs if design.name not in ("PI", "FF-PI")))
    shown = shown_designs(few)
    assert [design.name for design in shown[:3]] == [fin.best, "P-109", "FF-P"]
    rest = sorted(score for name, score in fin.scores.items() if name not in (fin.best, *TABLE_5_4))
    assert [fin.scores[design.name] for design in shown[3:]] == rest[:2]
    assert fin.best not in [design.name for design in shown_designs(replace(fin, best=None))[:4]]


def test_an_unstable_controller_is_named_and_left_out_of_the_file():
    keys = {"structure": "PI", "method": "simc", "compare": {"wild": {"p": 400}}}
    values = study(MAGNITUDE, (), PidFitSettings.model_validate(keys), CYCLE_S)
    result = summary_of(values)
    assert any(warning.startswith("wild is unstable") for warning in result.warnings)
    assert "wild" not in result.files["pid.toml"]
    assert "wild" in result.to_text()


def test_what_is_stored_is_json_without_infinities_and_what_is_shown_has_values(fin):
    result = summary_of(fin)
    stored = json.loads(json.dumps({**result.to_json(), **result.record()}, allow_nan=False))
    assert stored["recommended"] == fin.best
    assert stored["designs"]["p-optimum"]["gain_margin"] >= 2.0
    assert stored["loop"]["effective_dead_s"] == pytest.approx(BENCH.delay_s)
    panels = [panel for row in result.figure_data().rows for stack in row for panel in stack.panels]
    assert len(panels) == 5
    assert all(np.isfinite(curve.y).any() for panel in panels for curve in panel.curves)
    assert set(result.files) == {"pid.toml"}


def test_settings_that_do_not_fit_together_are_refused():
    for keys, message in (
        ({"range": [60, 20]}, "60 is not below 20"),
        ({"feedback": "latest", "period_s": 1.0}, "takes no mean"),
        ({"gain_margin": 0.5}, "greater than 1"),
        ({"structur": "PI"}, "structur"),
    ):
        with pytest.raises(ValidationError, match=message):
            PidFitSettings.model_validate(keys)


# --- from a fit, and from a run


def fitted_summary(**changes):
    """Responses whose names are parts of each other's names and of their parameters' names."""
    force = TransferFunction.first_order(0.009, 0.34, 0.28, **UNITS)
    angle = TransferFunction((-0.87,), (0.01, 0.2, 1.0), 0.1)
    keys = {
        "transfers": {"a": force, "angle": angle, "a_gain": force},
        "resampled": {
            "a": [
                TransferFunction.first_order(0.009, 0.34, 0.26),
                TransferFunction.first_order(0.009, -0.1, 0.28),
                TransferFunction.first_order(0.0, 0.34, 0.28),
                TransferFunction.first_order(0.0091, 0.34, 0.30),
            ]
        },
        "estimates": {
            "a": {"a_gain": Estimate(0.009, (0.0088, 0.0092), "N/deg")},
            "angle": {"angle_gain": Estimate(-0.87, (-1, -0.7), "1")},
            "a_gain": {"a_gain_gain": Estimate(0.009, (0.0088, 0.0092), "N/deg")},
        },
        **changes,
    }
    return TransferSummary(
        "fopdt",
        "fopdt",
        FittedData("fin-step", "run", 6),
        {key: estimate for mine in keys["estimates"].values() for key, estimate in mine.items()},
        rmse={"a": 0.01},
        warnings=("angle: few trials", "a: noisy because of the angle", "the run was stopped early"),
        **keys,
    )


def test_a_fitted_response_becomes_a_plant_with_the_resamples_that_settle():
    plant = plant_of(fitted_summary(), "a", 400)
    assert (plant.transfer.gain, plant.transfer.lag_s, plant.transfer.dead_s) == (0.009, 0.34, 0.28)
    assert plant.transfer.gain_unit == "N/deg"
    assert [other.dead_s for other in plant.plants] == [0.26, 0.30]
    assert [plant.dead_s for plant in plant_of(fitted_summary(), "a", 1).plants] == [0.26]


@pytest.mark.parametrize(
    ("response", "parameter", "warning"),
    [("a", "a_gain", "a: noisy because of the angle"), ("angle", "angle_gain", "angle: few trials")],
)
def test_a_plant_has_the_numbers_and_warnings_of_its_own_response_only(response, parameter, warning):
    plant = plant_of(fitted_summary(), response, 400)
    assert set(plant.parameters) == {parameter}
    assert warning in plant.warnings
    assert "the run was stopped early" in plant.warnings
    assert sum(other.startswith(("a:", "angle:")) for other in plant.warnings) == 1


def test_a_response_without_resamples_is_a_plant_and_says_so():
    plant = plant_of(fitted_summary(), "angle", 50)
    assert plant.transfer.order == 2
    assert plant.plants == ()
    assert any("no resampled plants" in warning for warning in plant.warnings)


def test_a_response_that_was_not_fitted_is_named_with_the_nearest():
    with pytest.raises(RequestError, match='did you mean "angle"'):
        plant_of(fitted_summary(), "angel", 50)
    with pytest.raises(FitError, match="no transfer function"):
        plant_of(FitSummary("hinge", "hinge", FittedData("x", "run", 1), {}), None, 50)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    loaded = load_named("fin-step", results, ("trial.repeats=2",))
    return execute(loaded, results=results, dry_run=True, seed=3, draw=False).run


def test_a_known_plant_takes_the_gaits_cycle_of_the_run(run):
    known = {"gain": GAIN, "lag_s": 0.34, "dead_s": 0.28, "input_unit": "deg", "output_unit": "N"}
    result = fit(run, model="pid", settings={"given_plant": known, "structure": "PI", "method": "simc"})
    stored = json.loads((run / "fit" / "pid.json").read_text())
    assert stored["loop"]["average_s"] == pytest.approx(CYCLE_S)
    assert stored["designs"]["pi-simc"]["p"] == pytest.approx(simc(BENCH, "PI").p, rel=1e-6)
    assert result.figure == run / "fit" / "pid.png"


def test_a_mean_needs_a_length(run):
    known = {"gain": GAIN, "lag_s": 0.34, "dead_s": 0.28}
    with pytest.raises(RequestError, match="not known over how long"):
        fit(run, model="pid", settings={"given_plant": known, "feedback": "moving-average"})


def test_the_plant_is_fitted_from_the_run_and_judged_over_its_resamples(run):
    result = fit(
        run,
        model="pid",
        settings={"structure": "PI", "method": "simc", "feedforward": False, "resamples": 50},
    )
    gain = result.parameters["magnitude_gain"]
    assert gain.value == pytest.approx(GAIN, rel=0.15)
    stored = json.loads((run / "fit" / "pid.json").read_text())
    low, high = stored["spreads"]["pi-simc"]["gain_margin_ci95"]
    assert low < stored["designs"]["pi-simc"]["gain_margin"] < high
    assert stored["plant"]["numerator"][-1] / stored["plant"]["denominator"][-1] == pytest.approx(gain.value)
    assert stored["plant"]["input_unit"] == "deg"
