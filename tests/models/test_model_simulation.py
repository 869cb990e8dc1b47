import warnings

import numpy as np
import pytest
from equations import FOLLOWER, OSCILLATOR, PENDULUM
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import parse_model, prepare, simulate, suggest_substeps

PENDULUM_MODEL = parse_model(PENDULUM, "pendulum.toml")
OSCILLATOR_MODEL = parse_model(OSCILLATOR, "oscillator.toml")
NO_INPUT = np.empty((401, 0))
TIME = np.linspace(0.0, 8.0, 401)


@settings(max_examples=15, deadline=None)
@given(angle=st.floats(-3.0, 3.0), rate=st.floats(-4.0, 4.0), damping=st.floats(0.0, 2.0))
def test_a_pendulum_moves_as_a_tight_scipy_integration_says(angle, rate, damping):
    result = simulate(
        PENDULUM_MODEL,
        TIME,
        NO_INPUT,
        parameters={"damping": damping},
        initial_state=[angle, rate],
        substeps=16,
    )
    exact = solve_ivp(
        lambda _, x: (x[1], -9.0 * np.sin(x[0]) - damping * x[1]),
        (0, 8),
        [angle, rate],
        "DOP853",
        TIME,
        rtol=1e-12,
        atol=1e-13,
    )
    # near the upright rest position any integrator's error grows with exp(3 t)
    tolerance = 1e-6 if abs(0.5 * rate**2 - 9 * np.cos(angle) - 9) > 0.5 else 1e-2
    assert np.max(np.abs(result.states - exact.y.T)) < tolerance


def test_energy_is_conserved_without_damping():
    result = simulate(
        PENDULUM_MODEL, TIME, NO_INPUT, parameters={"damping": 0.0}, initial_state=[2.5, 0.0], substeps=16
    )
    energy = result.outputs[:, 1]
    assert np.ptp(energy) < 1e-7 * np.abs(energy[0])


def test_a_linear_oscillator_rings_down_in_closed_form():
    inertia, stiffness, damping = 2.0, 50.0, 0.8
    result = simulate(OSCILLATOR_MODEL, TIME, np.zeros((401, 1)), initial_state=[0.3, 0.0], substeps=8)
    decay = damping / (2 * inertia)
    swing = np.sqrt(stiffness / inertia - decay**2)
    exact = 0.3 * np.exp(-decay * TIME) * (np.cos(swing * TIME) + decay / swing * np.sin(swing * TIME))
    assert result.outputs[:, 0] == pytest.approx(exact, abs=2e-7)
    assert result.outputs[:, 2] == pytest.approx(50.0 * exact, abs=1e-5)


def test_sample_times_need_not_be_even():
    rng = np.random.default_rng(3)
    time_s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.002, 0.05, 300))])
    result = simulate(parse_model(FOLLOWER, "f"), time_s, np.ones((301, 1)), initial_state=[0.0], substeps=4)
    assert result.outputs[:, 0] == pytest.approx(1 - np.exp(-time_s / 0.5), abs=1e-9)


def test_equations_see_the_time_of_the_trial():
    model = parse_model('name = "ramp"\nstates = ["y"]\n[equations]\ny = "2*t"\n[outputs]\ny = "y"', "r")
    time_s = np.linspace(3.0, 5.0, 11)
    result = simulate(model, time_s, np.empty((11, 0)), initial_state=[0.0], substeps=1)
    assert result.outputs[:, 0] == pytest.approx(time_s**2 - 9.0)


def test_a_model_without_states_is_its_outputs():
    model = parse_model(
        'name = "static"\ninputs = ["u"]\n[parameters]\ngain = 3\n[outputs]\ny = "gain*u^2"', "s"
    )
    u = np.linspace(-1, 1, 7)
    result = simulate(model, np.arange(7.0), u[:, None])
    assert result.outputs[:, 0] == pytest.approx(3 * u**2)
    assert result.states.shape == (7, 0)
    assert result.finite


MIXER = """
name = "mixer"
[inputs]
speed = { unit = "m/s", between = "hold" }
angle = { unit = "rad" }
[parameters]
gain = 3.0
[outputs]
lift = { equation = "gain*density*speed^2*sin(angle)", unit = "N" }
drag = "where(flap > 0.5, 2, 1)*gain*speed^2 + offset"
"""


def test_a_static_relation_has_inputs_outputs_and_conditions():
    model = parse_model(MIXER, "mixer.toml")
    assert model.states == ()
    assert set(model.conditions) == {"density", "flap", "offset"}
    rng = np.random.default_rng(3)
    time_s, inputs = np.arange(20.0), rng.normal(size=(20, 2))
    condition = {"density": 1.2, "flap": 1, "offset": 0.5, "day": "Monday"}
    speed, angle = inputs.T
    result = simulate(model, time_s, inputs, parameters={"gain": 2.0}, condition=condition)
    expected = np.column_stack([2.4 * speed**2 * np.sin(angle), 4 * speed**2 + 0.5])
    np.testing.assert_allclose(result.outputs, expected, rtol=1e-14)
    fixed = {"parameters": {"gain": 2.0}, "condition": condition}
    assert suggest_substeps(model, time_s, inputs, **fixed) == 1
    leak = load_effect("cross-talk").attach("lift", share=0.1)
    late = load_effect("delay", "input").attach("angle", delay=1.0)
    disturbed = simulate(model, time_s, inputs, effects=[leak, late], substeps=4, **fixed).outputs
    np.testing.assert_allclose(disturbed[:, 1], expected[:, 1], rtol=1e-14)
    shifted = 2.4 * speed[1:] ** 2 * np.sin(angle[:-1]) + 0.1 * expected[1:, 1]
    np.testing.assert_allclose(disturbed[1:, 0], shifted, rtol=1e-12)


def test_a_force_that_is_not_a_number_ends_the_simulation():
    text = OSCILLATOR.replace("10*angle", "sqrt(angle - 0.05)")  # undefined once the angle falls below 0.05
    model = parse_model(text, "o.toml")
    friction = load_effect("load-dependent-friction").attach("hinge", coefficient=0.1, transition_speed=0.1)
    time_s = np.linspace(0, 1, 101)
    nothing = np.zeros((101, 1))
    assert simulate(model, time_s, nothing, initial_state=[0.2, 0.0]).finite
    blown = simulate(model, time_s, nothing, initial_state=[0.2, 0.0], effects=[friction])
    assert not blown.finite
    assert np.isfinite(blown.outputs[0]).all()
    assert np.isnan(blown.outputs[-1]).all()


def test_a_simulation_that_blows_up_says_so_without_raising_or_warning():
    model = parse_model('name = "burst"\nstates = ["y"]\n[equations]\ny = "y^2"\n[outputs]\ny = "y"', "b")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = simulate(model, np.linspace(0, 3, 31), np.empty((31, 0)), initial_state=[1.0])
    assert not result.finite
    assert np.isfinite(result.outputs[:9]).all()
    assert np.isnan(result.outputs[-1, 0])


@pytest.mark.parametrize(
    "equation", ["1/(y - y)", "log(-1 - y^2)", "sqrt(-1 - y^2)", "exp(1e6 + y)", "(-2 - y^2)^0.5"]
)
def test_undefined_arithmetic_is_not_finite_instead_of_an_exception(equation):
    model = parse_model(
        f'name = "odd"\nstates = ["y"]\n[equations]\ny = "{equation}"\n[outputs]\ny = "y"', "o"
    )
    assert not simulate(model, np.arange(5.0), np.empty((5, 0)), initial_state=[0.0], substeps=1).finite


def test_suggested_substeps_reach_the_tolerance_they_promise():
    time_s = np.linspace(0, 4, 41)
    nothing = np.empty((41, 0))
    substeps = suggest_substeps(PENDULUM_MODEL, time_s, nothing, initial_state=[2.0, 0.0], tolerance=1e-5)
    coarse = simulate(PENDULUM_MODEL, time_s, nothing, initial_state=[2.0, 0.0], substeps=substeps).outputs
    fine = simulate(PENDULUM_MODEL, time_s, nothing, initial_state=[2.0, 0.0], substeps=64).outputs
    assert 1 < substeps < 64
    assert np.all(np.max(np.abs(coarse - fine), axis=0) <= 2e-5 * np.ptp(fine, axis=0))
    assert simulate(PENDULUM_MODEL, time_s, nothing, initial_state=[2.0, 0.0]).finite


def test_a_prepared_drive_gives_the_same_as_its_inputs():
    u = np.sin(TIME)[:, None]
    drive = prepare(OSCILLATOR_MODEL, TIME, u, 4)
    direct = simulate(OSCILLATOR_MODEL, TIME, u, initial_state=[0.0, 0.0], substeps=4)
    prepared = simulate(OSCILLATOR_MODEL, TIME, drive, initial_state=[0.0, 0.0])
    assert np.array_equal(direct.outputs, prepared.outputs)


def test_nominal_values_and_vectors_and_mappings_of_parameters_agree():
    u = np.ones((401, 1))
    simulated = simulate(
        OSCILLATOR_MODEL, TIME, u, parameters=np.array([3.0, 50.0, 0.8]), initial_state=[0, 0], substeps=2
    )
    two = simulate(OSCILLATOR_MODEL, TIME, u, parameters={"inertia": 3.0}, initial_state=[0, 0], substeps=2)
    three = simulate(
        OSCILLATOR_MODEL.with_values({"inertia": 3.0}), TIME, u, initial_state=[0, 0], substeps=2
    )
    assert np.array_equal(simulated.outputs, two.outputs)
    assert np.array_equal(simulated.outputs, three.outputs)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {"inertja": 1.0}}, "no parameter 'inertja'"),
        ({"parameters": np.ones(2)}, "has 3 parameters"),
        ({"initial_state": [0.0]}, "initial state of shape"),
        ({"inputs": np.ones((401, 2))}, "1 inputs at 401 times"),
        ({"inputs": np.full((401, 1), np.nan)}, "input 0 is not finite at sample 0"),
        ({"time_s": TIME[::-1]}, "time_s must increase"),
        ({"substeps": -1}, "substeps must be"),
    ],
)
def test_what_does_not_match_the_model_is_an_error(change, message):
    given_ = {
        "time_s": TIME,
        "inputs": np.ones((401, 1)),
        "initial_state": [0.0, 0.0],
        "substeps": 1,
        **change,
    }
    with pytest.raises(ModelError, match=message):
        simulate(OSCILLATOR_MODEL, given_.pop("time_s"), given_.pop("inputs"), **given_)


def test_a_state_begins_where_its_input_does():
    servo = parse_model(
        'name = "servo"\nstates = ["angle"]\ninputs = ["told"]\n[equations]\nangle = "9.0 * (told - angle)"\n'
        '[outputs]\nangle = "angle"\n[initial]\nangle = "told"\n',
        "servo.toml",
    )
    waits = simulate(servo, np.array([0.0, 1.0]), np.array([[0.7], [0.7]]))
    assert waits.outputs[:, 0] == pytest.approx([0.7, 0.7], abs=1e-12)
