"""Viscous friction that differs by direction, and linear drag and a constant force on a body, against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rig import named

from labrun.models import parse_model, simulate

MASS = 2.0
SLIDE = parse_model(
    'name = "slide"\nstates = ["way", "speed"]\ninputs = ["push"]\n[parameters]\nmass = 2.0\ndamping = 5.0\n'
    '[equations]\nway = "speed"\nspeed = "(push + force.carriage + force.hull - damping*speed)/mass"\n'
    '[outputs]\nspeed = "speed"\n'
    '[sites.carriage]\nkind = "joint"\ncoordinate = "way"\nrate = "speed"\n'
    '[sites.hull]\nkind = "body"\ncoordinate = "way"\nrate = "speed"\n[initial]\nway = 0.0\nspeed = 0.0\n',
    "slide.toml",
)
TIME = np.arange(0, 3, 0.01)


def _speed(push, *effects, start=0.0, **parameters):
    pushed = np.full((len(TIME), 1), push)
    return simulate(
        SLIDE, TIME, pushed, parameters=parameters, initial_state=[0.0, start], effects=effects, substeps=4
    ).outputs[:, 0]


@settings(max_examples=20, deadline=None)
@given(difference=st.floats(-4.0, 4.0), push=st.floats(-10.0, 10.0))
def test_either_direction_has_its_own_coefficient(difference, push):
    """From rest the speed grows as push/coefficient (1 - exp(-coefficient t/mass)), with that of its direction."""
    own = 5.0 + (difference if push > 0 else -difference)
    result = _speed(push, named("asymmetric-damping", site="carriage", difference=difference))
    assert result == pytest.approx(
        push / own * (1 - np.exp(-own * TIME / MASS)), abs=1e-6 * max(1, abs(push))
    )


@settings(max_examples=20, deadline=None)
@given(share=st.floats(-1.0, 1.0), start=st.floats(-5.0, 5.0))
def test_with_a_mean_above_the_difference_it_only_brakes(share, start):
    coasting = np.abs(
        _speed(0.0, named("asymmetric-damping", site="carriage", difference=5.0 * share), start=start)
    )
    assert np.all(np.diff(coasting) <= 1e-12)


def test_without_a_difference_nothing_changes():
    assert _speed(3.0, named("asymmetric-damping", site="carriage", difference=0.0)) == pytest.approx(
        _speed(3.0)
    )


@settings(max_examples=15, deadline=None)
@given(coefficient=st.floats(0.5, 8.0), force=st.floats(-5.0, 5.0))
def test_a_body_may_lack_linear_drag_and_a_constant_force(coefficient, force):
    drag = named("viscous-damping", "body", "hull", coefficient=coefficient)
    steady = named("constant-force", "body", "hull", force=force)
    result = _speed(0.0, drag, steady, start=1.0, damping=0.0)
    final = force / coefficient
    assert result == pytest.approx(final + (1.0 - final) * np.exp(-coefficient * TIME / MASS), abs=1e-6)
