"""Dry friction with a level for each direction of motion, against closed forms and limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import MODEL, named

from labrun.models import parse_model, simulate

STIFFNESS = 50.0
# the rate is prescribed, and the force is shown
PROBE = parse_model(
    'name = "probe"\nstates = ["q"]\ninputs = ["v"]\n[equations]\nq = "v + 0*force.pin"\n'
    '[outputs]\nforce = "force.pin"\n[sites.pin]\nkind = "joint"\ncoordinate = "q"\nrate = "v"\n',
    "probe.toml",
)


def _forces(rates, torque, asymmetry, transition_speed=0.01):
    """Return the force at each of these rates, (n,)."""
    friction = named(
        "asymmetric-friction",
        site="pin",
        torque=torque,
        asymmetry=asymmetry,
        transition_speed=transition_speed,
    )
    rates = np.asarray(rates, dtype=float)
    time_s = np.arange(len(rates)) * 1e-3
    result = simulate(PROBE, time_s, rates[:, None], initial_state=[0.0], effects=[friction], substeps=1)
    return result.outputs[:, 0]


def _swing(asymmetry, torque=0.4):
    """Return the turning points of a joint let go at 0.3 rad, with no other loss."""
    time_s = np.arange(0, 4, 0.001)
    friction = named("asymmetric-friction", torque=torque, asymmetry=asymmetry, transition_speed=1e-3)
    angle = simulate(
        MODEL, time_s, np.zeros((len(time_s), 2)), parameters={"damping": 0.0}, initial_state=[0.3, 0.0],
        effects=[friction], substeps=2,
    ).outputs[:, 0]  # fmt: skip
    inner = angle[1:-1]
    return inner[(inner - angle[:-2]) * (angle[2:] - inner) < 0]


@pytest.mark.parametrize("asymmetry", [-1.0, -0.3, 0.0, 0.5, 1.0])
def test_the_level_is_another_in_each_direction(asymmetry):
    forward, backward, resting = _forces([3.0, -3.0, 0.0], 2.0, asymmetry)
    assert forward == pytest.approx(-2.0 * (1 + asymmetry), abs=1e-12)
    assert backward == pytest.approx(2.0 * (1 - asymmetry), abs=1e-12)
    assert resting == 0.0


@settings(max_examples=60, deadline=None)
@given(
    torque=st.floats(0.0, 50.0),
    asymmetry=st.floats(-1.0, 1.0),
    transition_speed=st.floats(1e-4, 1.0),
    rates=st.lists(st.floats(-20.0, 20.0), min_size=2, max_size=20),
)
def test_it_never_pushes(torque, asymmetry, transition_speed, rates):
    assert np.all(_forces(rates, torque, asymmetry, transition_speed) * np.array(rates) <= 0.0)


def test_without_asymmetry_it_is_coulomb_friction():
    time_s = np.linspace(0, 3, 151)
    drive = np.column_stack([5 * np.sin(4 * time_s), np.zeros(151)])
    both = [
        simulate(MODEL, time_s, drive, effects=[case], substeps=8).outputs
        for case in (
            named("asymmetric-friction", torque=0.7, asymmetry=0.0, transition_speed=0.02),
            named("coulomb-friction", torque=0.7, transition_speed=0.02),
        )
    ]
    assert both[0] == pytest.approx(both[1], abs=1e-12)


@pytest.mark.parametrize("asymmetry", [-0.6, 0.0, 0.9])
def test_a_closed_cycle_costs_the_mean_level_over_both_strokes(asymmetry):
    """4 torque amplitude per cycle, whatever the asymmetry: what one stroke costs more, the other costs less."""
    amplitude, omega, torque = 0.2, 5.0, 1.5
    time_s = np.arange(0, 2 * np.pi / omega, 1e-3 / omega)
    rates = amplitude * omega * np.cos(omega * time_s)
    power = -_forces(rates, torque, asymmetry, 1e-4) * rates
    lost = np.sum(power) * (time_s[1] - time_s[0])
    assert lost == pytest.approx(4 * torque * amplitude, rel=2e-3)


@pytest.mark.parametrize("asymmetry", [0.4, -0.7])
def test_a_swing_shortens_by_another_step_in_each_direction(asymmetry):
    """A half-swing loses 2 level / stiffness of its excursion, with the level of its direction."""
    turning = _swing(asymmetry)
    first, second, third = -np.diff(np.abs([0.3, *turning[:3]]))
    assert first == pytest.approx(2 * 0.4 * (1 - asymmetry) / STIFFNESS, rel=0.03)
    assert second == pytest.approx(2 * 0.4 * (1 + asymmetry) / STIFFNESS, rel=0.03)
    assert third == pytest.approx(first, rel=0.03)


@pytest.mark.parametrize("asymmetry", [0.5, -0.5])
def test_a_driven_spring_is_displaced_by_the_mean_force(asymmetry):
    """In steady motion forces balance over a cycle: stiffness times mean angle is the mean of the friction."""
    torque, period_s = 1.0, 2.0
    friction = named("asymmetric-friction", torque=torque, asymmetry=asymmetry, transition_speed=1e-3)
    time_s = np.arange(0, 20, 0.002)
    drive = np.column_stack([20 * np.sin(2 * np.pi * time_s / period_s), np.zeros(len(time_s))])
    result = simulate(
        MODEL, time_s, drive, parameters={"damping": 8.0}, initial_state=[0.0, 0.0], effects=[friction], substeps=4
    )  # fmt: skip
    last = round(2 * period_s / 0.002)
    angle, rate = result.outputs[-last:, 0], result.outputs[-last:, 1]
    mean = np.mean(_forces(rate, torque, asymmetry, 1e-3))
    assert np.mean(angle) == pytest.approx(mean / STIFFNESS, rel=0.01)
    assert mean == pytest.approx(-torque * asymmetry, rel=0.03)


def test_in_motion_it_is_coulomb_friction_and_a_constant_force_and_at_rest_it_is_not():
    moving = np.array([-2.0, -0.1, 0.1, 2.0])
    assert _forces(moving, 2.0, 0.3) == pytest.approx(-2.0 * np.sign(moving) - 2.0 * 0.3, abs=1e-7)
    assert _forces([0.0, 0.0], 2.0, 0.3) == pytest.approx(0.0, abs=0.0)
