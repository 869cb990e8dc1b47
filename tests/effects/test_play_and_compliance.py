"""Two masses with play or a spring between them, against integrators of their own, and what is conserved."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import named
from scipy.integrate import solve_ivp

from labrun.models import parse_model, simulate

# a motor that a torque drives, with the inertia of the link in the model; friction only where a test wants it
FREE = parse_model(
    'name = "axis"\nstates = ["angle", "rate"]\ninputs = ["torque"]\n[parameters]\ninertia = 1.0\ndamping = 0.0\n'
    '[equations]\nangle = "rate"\nrate = "(torque + force.axis - damping*rate)/inertia"\n'
    '[outputs]\nangle = "angle"\nrate = "rate"\n'
    '[sites.axis]\nkind = "joint"\ncoordinate = "angle"\nrate = "rate"\n[initial]\nangle = 0.0\nrate = 0.0\n',
    "axis.toml",
)
TIME = np.arange(0, 3, 0.005)
LINK, GAP, CONTACT = 0.4, 0.1, 0.01


def _turning(torque, effect, **parameters):
    return simulate(FREE, TIME, torque[:, None], parameters=parameters, effects=[effect], substeps=20).outputs


def _gear_play(gap=GAP, link=LINK):
    return named("gear-play", site="axis", inertia=link, gap=gap, contact_period=CONTACT)


def _pushed(d, relative, gap=GAP):
    """Return the link's acceleration in contact with a motor that is ahead by `d`, at that relative speed."""
    depth = d - np.clip(d, -gap / 2, gap / 2)
    push = depth / CONTACT**2 + 0.6 / CONTACT * relative
    return max(push, 0.0) if depth > 0 else min(push, 0.0) if depth < 0 else 0.0


def test_a_motor_with_play_moves_as_two_bodies_do():
    """Newton for each body by itself; the library has the sum of both in the model, and takes the link's part away."""

    def slope(t, x):
        q, rate, link, v = x
        through = LINK * _pushed(q - link, rate - v)
        return rate, (2 * np.sin(6 * t) - through) / (1.0 - LINK), v, through / LINK

    exact = solve_ivp(slope, (0, 3), [0.0] * 4, "RK45", TIME, rtol=1e-7, atol=1e-9, max_step=2e-3).y
    turning = _turning(2 * np.sin(6 * TIME), _gear_play())
    assert turning[:, 0] == pytest.approx(exact[0], abs=2e-3 * np.ptp(exact[0]))
    rigid = simulate(FREE, TIME, 2 * np.sin(6 * TIME)[:, None], substeps=4).outputs[:, 0]
    assert np.max(np.abs(rigid - exact[0])) > 0.02 * np.ptp(exact[0])


def test_within_the_play_the_motor_turns_alone():
    torque = np.where(TIME < 0.05, 0.5, 0.0)
    turning = _turning(torque, _gear_play(gap=10.0))
    assert turning[-1, 1] == pytest.approx(np.trapezoid(torque, TIME) / (1.0 - LINK), rel=1e-6)


def test_a_push_is_shared_by_both_bodies_in_the_end():
    """Momentum is conserved through contacts, and what is lost in them leaves one speed for both."""
    torque = np.where(TIME < 0.05, 20.0, 0.0)
    turning = _turning(torque, _gear_play())
    assert np.mean(turning[-200:, 1]) == pytest.approx(np.trapezoid(torque, TIME), rel=0.02)


@settings(max_examples=10, deadline=None)
@given(gap=st.floats(0.01, 0.3), link=st.floats(0.1, 0.8), push=st.floats(-30.0, 30.0))
def test_play_gives_no_energy(gap, link, push):
    torque = np.where(TIME < 0.05, push, 0.0)
    rate = _turning(torque, _gear_play(gap, link))[:, 1]
    alone = np.trapezoid(torque, TIME) / (1.0 - link)
    assert np.max(np.abs(rate)) <= abs(alone) * (1 + 1e-6)


@pytest.mark.parametrize(("base", "stiffness"), [(0.8, 300.0), (5.0, 2000.0)])
def test_a_base_that_gives_way_is_an_elastic_transmission_of_other_numbers(base, stiffness):
    """Measured against its base, a link is driven as a motor is in front of a link that hangs on a spring."""

    def slope(t, x):
        _, rate, lean, leaning = x
        torque = np.sin(9 * t) + np.sin(23 * t)
        of_base = (-torque - stiffness * lean) / base
        return rate, torque / 1.0 - of_base, leaning, of_base

    exact = solve_ivp(slope, (0, 3), [0.0] * 4, "DOP853", TIME, rtol=1e-10, atol=1e-12, max_step=2e-3).y[0]
    fine = np.arange(0, 3, 0.0005)
    torque = (np.sin(9 * fine) + np.sin(23 * fine))[:, None]
    elastic = named(
        "elastic-transmission", site="axis", inertia=1.0 / (1.0 + base),
        period=np.sqrt((1.0 + base) / stiffness), damping_ratio=0.0,
    )  # fmt: skip
    result = simulate(FREE, fine, torque, effects=[elastic], substeps=2).outputs[::10, 0]
    assert result == pytest.approx(exact, abs=1e-5 * np.ptp(exact))


SERVO = """
name = "servo"
states = ["angle", "rate"]
[inputs]
goal = { unit = "rad", between = "linear" }
[parameters]
kp = 60.0
kv = 3.0
weight = 0.0
[equations]
angle = "rate"
rate  = "(force.joint + kp*(goal - angle) - kv*rate - weight)/0.4"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind = "joint"
coordinate = "angle"
rate = "rate"
load = "kp*(goal - angle) - kv*rate"
drive = true
[initial]
angle = 0.0
rate = 0.0
"""


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_a_servo_that_sees_its_own_motor_leaves_its_link_as_a_light_motor_behind_play_does(weight):
    """Motor and link by themselves: a light motor on the servo, a stiff contact behind half of the play."""
    gap, motor, contact = 0.06, 1e-3, 2e4

    def slope(t, x):
        angle, speed, q, rate = x
        d = angle - q
        depth = d - np.clip(d, -gap / 2, gap / 2)
        through = contact * depth + (10.0 * (speed - rate) if depth != 0 else 0.0)
        goal = 0.5 * np.sin(2 * t)
        servo = 60 * (goal - angle) - 3 * speed
        return speed, (servo - through) / motor, rate, (through - weight) / 0.4

    exact = solve_ivp(slope, (0, 3), [0.0] * 4, "Radau", TIME, rtol=1e-6, atol=1e-8, max_step=0.02).y[2]
    goal = 0.5 * np.sin(2 * TIME)[:, None]
    model = parse_model(SERVO, "servo.toml")
    play = named("drive-play", site="joint", torque=60 * gap / 2)
    plain, result = (
        simulate(model, TIME, goal, parameters={"weight": weight}, effects=effects, substeps=4).outputs[:, 0]
        for effects in ([], [play])
    )
    assert np.sqrt(np.mean((result - exact) ** 2)) < 0.15 * np.sqrt(np.mean((plain - exact) ** 2))


@settings(max_examples=25, deadline=None)
@given(torque=st.floats(0.0, 5.0), weight=st.floats(0.5, 4.0), side=st.sampled_from([-1.0, 1.0]))
def test_a_loaded_link_rests_half_of_the_play_further_than_its_servo_lets_it_sink(torque, weight, side):
    model = parse_model(SERVO, "servo.toml")
    play = named("drive-play", site="joint", torque=torque)
    time_s = np.arange(0, 4, 0.01)
    result = simulate(
        model,
        time_s,
        np.zeros((len(time_s), 1)),
        parameters={"weight": side * weight},
        effects=[play],
        substeps=4,
    ).outputs[-1, 0]
    sunk = -side * (weight + torque) / 60.0
    assert result == pytest.approx(sunk, abs=1e-4)
