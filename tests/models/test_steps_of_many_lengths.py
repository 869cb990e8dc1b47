"""An interval between two samples takes as many of the integrator's steps as it is told, whatever the others take."""

import dataclasses

import numpy as np
import pytest
from equations import OSCILLATOR
from scipy.integrate import solve_ivp

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import filtered, parse_model, prepare, simulate, simulate_unfiltered

MODEL = parse_model(OSCILLATOR, "oscillator.toml")
WIRE = parse_model('name = "wire"\ninputs = ["u"]\n[outputs]\ny = "u"', "wire.toml")
TIME = np.linspace(0.0, 4.0, 201)
WAVE = np.sin(5.0 * TIME)[:, None]
COUNTS = np.random.default_rng(3).choice([1, 2, 4, 16], 200)
FRICTION = load_effect("coulomb-friction").attach("hinge", torque=2.0, transition_speed=2e-3, presliding=0.0)
START = [0.3, 0.0]


def _run(substeps, effects=(), between="linear", model=MODEL):
    model = model.with_between({model.inputs[0].name: between})
    begin = {"initial_state": START} if model.states else {}
    return simulate(model, TIME, prepare(model, TIME, 6 * WAVE, substeps), effects=effects, **begin)


@pytest.mark.parametrize("between", ["hold", "linear", "band-limited"])
@pytest.mark.parametrize("substeps", [1, 3, 4])
def test_the_same_number_in_all_intervals_is_that_number(substeps, between):
    everywhere = _run(np.full(200, substeps), [FRICTION], between)
    plain = _run(substeps, [FRICTION], between)
    np.testing.assert_array_equal(everywhere.outputs, plain.outputs)
    np.testing.assert_array_equal(everywhere.states, plain.states)


@pytest.mark.parametrize("between", ["hold", "linear", "band-limited"])
def test_every_interval_has_its_own_steps_and_inputs_on_them(between):
    model = MODEL.with_between({"torque": between})
    mixed = prepare(model, TIME, WAVE, COUNTS)
    assert len(mixed.steps_s) == COUNTS.sum()
    assert np.add.reduceat(mixed.steps_s, mixed.grid.rows[:-1]) == pytest.approx(np.diff(TIME))
    for interval in range(200):
        alike = prepare(model, TIME, WAVE, int(COUNTS[interval]))
        rows = slice(*mixed.grid.rows[interval : interval + 2])
        whole = slice(*alike.grid.rows[interval : interval + 2])
        np.testing.assert_array_equal(mixed.u[rows], alike.u[whole])
        np.testing.assert_array_equal(mixed.steps_s[rows], alike.steps_s[whole])


def test_two_steps_of_one_interval_are_taken_as_one_where_their_number_is_even():
    pairs = prepare(MODEL, TIME[:4], WAVE[:4], np.array([1, 4, 3])).grid.pairs
    assert pairs.tolist() == [False, True, False, True, False, False, False, False]


def test_smooth_motion_is_as_exact_as_the_longest_steps_make_it():
    fine, coarse, mixed = (_run(substeps).states for substeps in (64, 1, COUNTS))
    assert 0 < np.abs(mixed - fine).max() < np.abs(coarse - fine).max()


def test_short_steps_at_reversals_alone_do_for_friction_that_sticks_and_slips():
    law = {"torque": 2.0, "transition_speed": 2e-3}

    def truth(time_s, x):
        friction = law["torque"] * np.tanh(x[1] / law["transition_speed"])
        return x[1], (6 * np.interp(time_s, TIME, WAVE[:, 0]) - friction - 50.0 * x[0] - 0.8 * x[1]) / 2.0

    exact = solve_ivp(truth, (0, 4), START, "Radau", TIME, rtol=1e-9, atol=1e-11, max_step=0.01).y.T
    slow = np.abs(exact[:, 1]) < 0.15
    slow = np.convolve(slow[:-1] | slow[1:], np.ones(3), "same") > 0
    assert 0.1 < slow.mean() < 0.5
    fine, mixed, coarse = (_run(substeps, [FRICTION]).states for substeps in (64, np.where(slow, 64, 2), 2))
    away = [np.abs(states - exact).max(axis=0) / np.ptp(exact, axis=0) for states in (fine, mixed, coarse)]
    assert np.all(away[1] < 2e-4)
    assert np.all(away[1] < 0.05 * away[2])
    assert np.all(away[1] < 2.0 * away[0] + 1e-4)


OF_INPUTS = {
    "delay": {"delay": 0.137},
    "lag": {"time_constant": 0.05},
    "rate-limit": {"rate": 12.0},
    "late-clock": {"lead": 0.037},
}
OF_OUTPUTS = {
    "delay": {"delay": 0.137},
    "lag": {"time_constant": 0.05},
    "play": {"width": 1.5},
    "early-clock": {"lead": 0.037},
}


@pytest.mark.parametrize("between", ["hold", "linear"])
@pytest.mark.parametrize("name", OF_INPUTS)
def test_a_filter_of_an_input_gives_the_same_whatever_the_steps(name, between):
    effect = load_effect(name, "input").attach("u", **OF_INPUTS[name])
    fine, mixed = (_run(substeps, [effect], between, WIRE).outputs for substeps in (16, COUNTS))
    assert np.ptp(fine) > 4.0
    # a limit that catches up with its signal within a step is straight up to the end of that
    tolerance = 12.0 * 0.02 / 4 if name == "rate-limit" else 1e-6
    assert mixed == pytest.approx(fine, abs=tolerance)


@pytest.mark.parametrize("name", OF_OUTPUTS)
def test_a_filter_of_an_output_gives_the_same_whatever_the_steps(name):
    effect = load_effect(name, "output").attach("y", **OF_OUTPUTS[name])
    fine, mixed = (_run(substeps, [effect], "linear", WIRE).outputs for substeps in (16, COUNTS))
    assert np.ptp(fine) > 4.0
    assert mixed == pytest.approx(fine, abs=1e-6)


def test_filters_before_and_behind_a_motion_are_as_exact_as_the_longest_steps_make_them():
    effects = [
        load_effect("delay", "input").attach("torque", delay=0.0333),
        load_effect("lag", "output").attach("angle", time_constant=0.05),
        load_effect("delay", "output").attach("angle", delay=0.0471),
    ]
    fine, mixed, coarse = (_run(substeps, effects).outputs for substeps in (64, COUNTS, 1))
    away, far = (np.abs(states - fine).max() for states in (mixed, coarse))
    assert away < 1.05 * far
    assert away < 2e-3 * np.ptp(fine)


def test_what_is_behind_outputs_is_added_to_one_simulation_of_the_motion():
    lag = load_effect("lag", "output").attach("angle", time_constant=0.05)
    driven = prepare(MODEL, TIME, WAVE, COUNTS)
    before = simulate_unfiltered(MODEL, driven, initial_state=START)
    assert len(before.outputs) == COUNTS.sum() + 1
    np.testing.assert_array_equal(
        filtered(MODEL, before, [lag]).outputs,
        simulate(MODEL, TIME, driven, initial_state=START, effects=[lag]).outputs,
    )
    np.testing.assert_array_equal(
        filtered(MODEL, before, []).outputs, simulate(MODEL, TIME, driven, initial_state=START).outputs
    )


def test_a_motion_that_blows_up_on_steps_of_many_lengths_is_told_and_ends_there():
    driven = prepare(MODEL, TIME, WAVE, COUNTS)
    u = driven.u.copy()
    u[driven.grid.rows[100] + 1 :] = np.inf
    broken = simulate(MODEL, TIME, dataclasses.replace(driven, u=u), initial_state=START)
    assert not broken.finite
    assert np.isfinite(broken.states[:101]).all()
    assert np.isnan(broken.states[102:]).all()


@pytest.mark.parametrize(
    ("counts", "message"), [(np.ones(5, dtype=int), "intervals"), (np.zeros(200, dtype=int), "1 or more")]
)
def test_steps_that_fit_no_trial_are_refused(counts, message):
    with pytest.raises(ModelError, match=message):
        prepare(MODEL, TIME, WAVE, counts)
