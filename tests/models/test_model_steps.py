import dataclasses

import numpy as np
import pytest
from equations import OSCILLATOR, PENDULUM
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from labrun.effects import Effect, EffectParameter, force_law, load_effect
from labrun.models import Input, Output, Parameter, Site, parse_model, prepare, python_model, simulate

PENDULUM_MODEL = parse_model(PENDULUM, "pendulum.toml")
MODEL = parse_model(OSCILLATOR, "oscillator.toml")
TIME = np.linspace(0.0, 4.0, 81)
DRIVE = np.sin(5.0 * TIME)[:, None]
DRAG = load_effect("quadratic-drag")
LAG = load_effect("lag", "output")
GAIN = load_effect("gain-error", "output")


def pull(t, q, rate, acceleration, load, stiffness, values, z, dz):
    return -values[0] * load


SILENT = Effect(
    id="silent",
    kind="joint",
    parameters=(EffectParameter("share", "ratio", neutral=0.0, lower=0.0, upper=1.0, starts=(0.1,)),),
    function=force_law(pull),
    form="F = -share * load",
    source="a law that reads the load and does not say so",
)


def derivative(t, x, u, p, force, dx):
    dx[0] = x[1]
    dx[1] = (u[0] + force[0] - p[1] * x[0] - p[2] * x[1]) / p[0]


def output(t, x, u, p, force, y):
    y[0] = x[0]
    y[1] = u[0]
    y[2] = p[1] * x[0] - force[0]


def _by_hand():
    """Return the oscillator as Python functions whose site is described by expressions instead of names."""
    return python_model(
        "oscillator",
        derivative=derivative,
        output=output,
        states=["angle", "rate"],
        inputs=[Input("torque")],
        outputs=[Output("angle"), Output("torque"), Output("spring")],
        parameters=[
            Parameter("inertia", 2.0, 0.1),
            Parameter("stiffness", 50.0),
            Parameter("damping", 0.8),
        ],
        sites=[Site("hinge", "joint", "angle + 0", "rate + 0", "10*angle", "stiffness + 0")],
    )


@pytest.mark.parametrize(("substeps", "order"), [((1, 3), 4), ((8, 16), 5)])
def test_a_single_step_is_of_order_four_and_a_pair_of_order_five(substeps, order):
    exact = solve_ivp(
        lambda _, x: (x[1], -9.0 * np.sin(x[0]) - 0.3 * x[1]),
        (0, 4), [1.5, 0.0], "DOP853", TIME, rtol=1e-13, atol=1e-14,
    ).y.T  # fmt: skip
    nothing = np.empty((81, 0))
    coarse, fine = (
        np.abs(
            simulate(PENDULUM_MODEL, TIME, nothing, initial_state=[1.5, 0.0], substeps=substep).states - exact
        ).max()
        for substep in substeps
    )
    assert np.log(coarse / fine) / np.log(substeps[1] / substeps[0]) == pytest.approx(order, abs=0.35)


def test_an_input_that_jumps_between_two_substeps_is_stepped_to_the_jump():
    drive = prepare(MODEL, TIME[:2], np.zeros((2, 1)), 2)
    u = drive.u.copy()
    u[1] = 1.0  # on from the middle of the only interval
    jumping = dataclasses.replace(drive, u=u, u_last=np.ones(1))
    state = simulate(MODEL, TIME[:2], jumping, initial_state=[0.0, 0.0]).states[-1]
    half_s = 0.5 * (TIME[1] - TIME[0])
    later = simulate(
        MODEL, np.array([0.0, half_s]), np.ones((2, 1)), initial_state=[0.0, 0.0], substeps=1
    ).states[-1]
    assert state == pytest.approx(later, abs=1e-12)


def test_an_output_effect_leaves_the_motion_as_it_is_and_sees_it_between_the_samples():
    plain = simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=4)
    neutral = simulate(
        MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=4, effects=[GAIN.attach("angle", error=0.0)]
    )
    assert np.array_equal(neutral.states, plain.states)
    lag = LAG.attach("angle", time_constant=0.03)
    lagged, fine = (
        simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=steps, effects=[lag]).outputs[:, 0]
        for steps in (8, 64)
    )
    assert lagged == pytest.approx(fine, abs=5e-4)
    assert np.max(np.abs(lagged - plain.outputs[:, 0])) > 0.02


@settings(max_examples=20, deadline=None)
@given(coefficient=st.floats(0.0, 3.0), share=st.floats(-0.5, 0.5), substeps=st.sampled_from([1, 2, 3]))
def test_a_site_of_plain_names_is_read_as_its_function_gives_it(coefficient, share, substeps):
    for effects in (
        [DRAG.attach("hinge", coefficient=coefficient)],
        [DRAG.attach("hinge", coefficient=coefficient), SILENT.attach("hinge", share=share)],
    ):
        named, called = (
            simulate(model, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=substeps, effects=effects).outputs
            for model in (MODEL, _by_hand())
        )
        assert named == pytest.approx(called, abs=1e-12)


def test_a_law_that_reads_the_load_without_saying_so_gets_it():
    effect = SILENT.attach("hinge", share=0.5)
    loaded = simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2, effects=[effect]).outputs
    stiffer = simulate(
        MODEL, TIME, DRIVE, parameters={"stiffness": 55.0}, initial_state=[0.3, 0.0], substeps=2
    ).outputs
    assert loaded == pytest.approx(stiffer, abs=1e-12)


def test_changed_values_and_changed_models_are_noticed():
    weak, strong = (DRAG.attach("hinge", coefficient=coefficient) for coefficient in (0.1, 2.0))
    first = simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2, effects=[weak]).outputs
    second = simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2, effects=[strong]).outputs
    again = simulate(MODEL, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2, effects=[weak]).outputs
    assert not np.array_equal(first, second)
    assert np.array_equal(first, again)
    carrying = dataclasses.replace(MODEL, effects=(strong,))
    assert np.array_equal(
        simulate(carrying, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2).outputs, second
    )
    for _ in range(50):  # models come and go, and a new one may lie where an old one lay
        model = dataclasses.replace(MODEL, effects=(weak,))
        assert np.array_equal(
            simulate(model, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2).outputs, first
        )
        plain = dataclasses.replace(MODEL)
        assert not np.array_equal(
            simulate(plain, TIME, DRIVE, initial_state=[0.3, 0.0], substeps=2).outputs, first
        )
        del model, plain
