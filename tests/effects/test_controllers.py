"""What a drive's controller does and a model's does not: feedforward, integral term, torque limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import named
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from labrun.models import parse_model, simulate

INERTIA, KP, KV, WEIGHT = 0.4, 60.0, 6.0, 9.0
# a link on a position servo; its goal moves by t where the model is told so, and the controller may know its torque
SERVO = """
name = "servo"
states = ["angle", "rate"]
[inputs]
goal = { unit = "rad", between = "hold" }
[parameters]
inertia = 0.4
kp = 60.0
kv = 6.0
weight = 9.0
compensated = 0.0
[equations]
angle = "rate"
rate  = '''(force.joint + force.controller + kp*(goal - angle) - kv*rate - (1 - compensated)*weight*sin(angle))
  / inertia'''
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "kp*(goal - angle) - kv*rate"
drive = true
[sites.controller]
kind = "controller"
coordinate = "weight*sin(angle)"
rate = "PLANNED"
[initial]
angle = 0.0
rate = 0.0
"""
PLAN = "inertia*(-0.5*9*sin(3*t)) + kv*(0.5*3*cos(3*t)) + weight*sin(0.5*sin(3*t))"
MODEL = parse_model(SERVO.replace("PLANNED", PLAN), "servo.toml")
TIME = np.arange(0, 4, 0.01)


def _held(goal, *effects, **parameters):
    """Return the angle under a goal that is held from the beginning."""
    goals = np.full((len(TIME), 1), goal)
    return simulate(MODEL, TIME, goals, parameters=parameters, effects=effects, substeps=4).outputs[:, 0]


def _rest(goal, share):
    """Return where a servo rests whose controller holds a share of the weight."""
    return brentq(lambda q: KP * (goal - q) - (1 - share) * WEIGHT * np.sin(q), -4, 4)


@settings(max_examples=25, deadline=None)
@given(share=st.floats(0.0, 1.0), goal=st.floats(-1.5, 1.5))
def test_a_joint_settles_where_servo_and_the_rest_of_its_weight_balance(share, goal):
    angle = _held(goal, named("gravity-compensation", "controller", "controller", share=share))
    assert angle[-1] == pytest.approx(_rest(goal, share), abs=1e-6)


def test_whole_compensation_leaves_no_error_at_rest_and_none_leaves_the_model_as_it_is():
    whole = named("gravity-compensation", "controller", "controller", share=1.0)
    none = named("gravity-compensation", "controller", "controller", share=0.0)
    assert _held(0.8, whole)[-1] == pytest.approx(0.8, abs=1e-7)
    assert _held(0.8, none) == pytest.approx(_held(0.8), abs=0.0)


def test_a_negative_share_takes_away_what_the_models_controller_holds():
    missing = named("gravity-compensation", "controller", "controller", share=-1.0)
    assert _held(0.8, missing, compensated=1.0) == pytest.approx(_held(0.8), abs=1e-9)


def test_a_joint_whose_controller_knows_the_whole_motion_follows_its_goal_exactly():
    """Computed torque: started on the goal, with the right torque, the error stays zero; without, it does not."""
    moving = parse_model(
        SERVO.replace("PLANNED", PLAN).replace("(goal - angle)", "(0.5*sin(3*t) - angle)"), "m"
    )
    nothing, start = np.zeros((len(TIME), 1)), [0.0, 1.5]
    planned = named("dynamics-feedforward", "controller", "controller", share=1.0)
    goal = 0.5 * np.sin(3 * TIME)
    followed = simulate(moving, TIME, nothing, initial_state=start, effects=[planned], substeps=8).outputs[
        :, 0
    ]
    alone = simulate(moving, TIME, nothing, initial_state=start, substeps=8).outputs[:, 0]
    assert followed == pytest.approx(goal, abs=1e-8)
    assert np.max(np.abs(alone - goal)) > 0.05


def _by_scipy(torque, states=0, goal=0.7):
    """Return the angle under ``torque(t, q, v, z) -> (torque, dz)`` in place of the model's servo."""

    def slope(t, x):
        push, dz = torque(t, x[0], x[1], x[2:])
        return x[1], (push - WEIGHT * np.sin(x[0])) / INERTIA, *dz

    start = [0.0] * (2 + states)
    return solve_ivp(slope, (0, TIME[-1]), start, "DOP853", TIME, rtol=1e-10, atol=1e-12, max_step=0.005).y[0]


@pytest.mark.parametrize(("integral_time", "wound"), [(0.3, 0.0), (1.0, 4.0)])
def test_an_integral_term_integrates_the_error_and_starts_from_what_it_holds(integral_time, wound):
    def torque(_t, q, v, z):
        return KP * (0.7 - q) - KV * v + wound + z[0], [KP * (0.7 - q) / integral_time]

    effect = named("integral-term", site="joint", integral_time=integral_time, wound=wound, braking=KV)
    goals = np.full((len(TIME), 1), 0.7)
    angle = simulate(MODEL, TIME, goals, effects=[effect], substeps=16).outputs[:, 0]
    assert angle == pytest.approx(_by_scipy(torque, 1), abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(goal=st.floats(-1.0, 1.0), braking=st.sampled_from([0.0, KV]), integral_time=st.floats(0.2, 0.4))
def test_an_integral_term_leaves_no_error_at_rest(goal, braking, integral_time):
    effect = named("integral-term", site="joint", integral_time=integral_time, wound=0.0, braking=braking)
    goals = np.full((1000, 1), goal)
    angle = simulate(MODEL, np.arange(1000) * 0.01, goals, effects=[effect], substeps=4).outputs[:, 0]
    assert angle[-1] == pytest.approx(goal, abs=2e-3)
    assert abs(_rest(goal, 0.0) - goal) >= abs(angle[-1] - goal) - 1e-9


@pytest.mark.parametrize("level", [7.0, 15.0])
def test_a_torque_limit_cuts_what_the_drive_asks_for(level):
    limited = named("torque-limit", site="joint", level=level)
    goals = np.full((len(TIME), 1), 0.7)
    angle = simulate(MODEL, TIME, goals, effects=[limited], substeps=32).outputs[:, 0]
    exact = _by_scipy(lambda _t, q, v, _z: (np.clip(KP * (0.7 - q) - KV * v, -level, level), []))
    assert angle == pytest.approx(exact, abs=2e-5)


def test_a_torque_limit_is_a_motors_line_without_its_slope():
    flat = named("torque-limit", site="joint", level=8.0)
    sloped = named("torque-speed-limit", site="joint", stall=8.0, no_load=1e9)
    assert _held(0.7, flat) == pytest.approx(_held(0.7, sloped), abs=1e-7)
