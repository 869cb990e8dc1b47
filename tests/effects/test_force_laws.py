import numpy as np
import pytest
from rig import MODEL, named
from scipy.integrate import solve_ivp

from labrun.models import parse_model, simulate

TIME = np.linspace(0, 3, 151)
DRIVE = np.column_stack([np.zeros(151), np.zeros(151)])
INERTIA, STIFFNESS, DAMPING = 2.0, 50.0, 0.8


def _exact(force, inertia=INERTIA):
    def slope(_, x):
        return x[1], (-STIFFNESS * x[0] - DAMPING * x[1] + force(*x)) / inertia

    return solve_ivp(slope, (0, 3), [0.3, 0.0], "DOP853", TIME, rtol=1e-10, atol=1e-12, max_step=0.002).y[0]


@pytest.mark.parametrize(
    ("effect", "force"),
    [
        (named("viscous-damping", coefficient=0.7), lambda q, v: -0.7 * v),
        (named("quadratic-drag", coefficient=0.5), lambda q, v: -0.5 * abs(v) * v),
        (named("cubic-stiffness", coefficient=200.0), lambda q, v: -200 * q**3),
        (named("rest-offset", offset=0.05), lambda q, v: 50 * 0.05),
        (named("constant-force", force=1.5), lambda q, v: 1.5),
        (named("coulomb-friction", torque=1.0, transition_speed=0.02), lambda q, v: -np.tanh(v / 0.02)),
        (named("drag-error", "body", coefficient=40.0), lambda q, v: -40 * 0.01 * abs(v) * v),
    ],
    ids=lambda one: getattr(getattr(one, "effect", None), "id", ""),
)
def test_a_force_law_moves_the_joint_as_scipy_says(effect, force):
    result = simulate(MODEL, TIME, DRIVE, effects=[effect], substeps=64)
    assert result.outputs[:, 0] == pytest.approx(_exact(force), abs=2e-6)


def test_friction_alone_ends_a_swing_in_equal_steps():
    """Free oscillation with Coulomb friction loses 4 torque / stiffness of its excursion in each period."""
    torque = 0.4
    time_s = np.arange(0, 4, 0.001)
    result = simulate(
        MODEL, time_s, np.zeros((len(time_s), 2)), parameters={"damping": 0.0}, initial_state=[0.3, 0.0], substeps=1,
        effects=[named("coulomb-friction", torque=torque, transition_speed=1e-3)],
    )  # fmt: skip
    angle = result.outputs[:, 0]
    peaks = angle[1:-1][(angle[1:-1] > angle[:-2]) & (angle[1:-1] >= angle[2:])]
    assert len(peaks) >= 2
    assert np.diff([0.3, *peaks]) == pytest.approx(-4 * torque / STIFFNESS, rel=0.02)


@pytest.mark.parametrize("inertia", [-0.8, 0.5, 3.0])
def test_added_inertia_is_inertia(inertia):
    effect = simulate(MODEL, TIME, DRIVE, effects=[named("added-inertia", inertia=inertia)], substeps=4)
    value = simulate(MODEL, TIME, DRIVE, parameters={"inertia": INERTIA + inertia}, substeps=4)
    assert effect.outputs == pytest.approx(value.outputs, abs=1e-11)


def test_added_inertia_and_other_effects_act_together():
    both = [
        named("viscous-damping", coefficient=0.7),
        named("added-inertia", inertia=1.0),
        named("constant-force", force=1.0),
    ]
    together = simulate(MODEL, TIME, DRIVE, effects=both, substeps=16).outputs[:, 0]
    assert together == pytest.approx(_exact(lambda q, v: 1.0 - 0.7 * v, inertia=3.0), abs=1e-6)
    for order in (both[::-1], [both[1], both[0], both[2]]):
        assert simulate(MODEL, TIME, DRIVE, effects=order, substeps=16).outputs[:, 0] == pytest.approx(
            together, abs=1e-12
        )


def test_added_inertia_at_two_coupled_joints_is_solved_for_both():
    """A double mass: inertia at a relative coordinate, whose rate is an expression."""
    text = """
name = "two"
states = ["x1", "v1", "x2", "v2"]
[parameters]
m1 = 1.0
m2 = 2.0
k = 30.0
[equations]
x1 = "v1"
v1 = "(-k*x1 + k*(x2 - x1) + force.ground - force.between)/m1"
x2 = "v2"
v2 = "(-k*(x2 - x1) + force.between)/m2"
[outputs]
x1 = "x1"
x2 = "x2"
[sites.ground]
kind = "joint"
coordinate = "x1"
rate = "v1"
[sites.between]
kind = "joint"
coordinate = "x2 - x1"
rate = "v2 - v1"
"""
    model = parse_model(text, "two.toml")
    start = [0.1, 0.0, -0.2, 0.3]
    a, b, k = 0.4, 0.7, 30.0
    effects = [
        named("added-inertia", site="ground", inertia=a),
        named("added-inertia", site="between", inertia=b),
    ]
    result = simulate(model, TIME, np.empty((151, 0)), initial_state=start, effects=effects, substeps=16)
    mass = np.array([[1.0 + a + b, -b], [-b, 2.0 + b]])

    def slope(_, x):
        pull = [-k * x[0] + k * (x[2] - x[0]), -k * (x[2] - x[0])]
        v1, v2 = np.linalg.solve(mass, pull)
        return x[1], v1, x[3], v2

    exact = solve_ivp(slope, (0, 3), start, "DOP853", TIME, rtol=1e-11, atol=1e-12).y[[0, 2]].T
    assert result.outputs == pytest.approx(exact, abs=1e-6)


def test_outputs_may_show_the_force_an_effect_exerts():
    text = (
        'name = "held"\nstates = ["q"]\n[equations]\nq = "1 + 0*force.pin"\n[outputs]\nreaction = "force.pin"\n'
        '[sites.pin]\nkind = "joint"\ncoordinate = "q"\nrate = "1"\n'
    )
    model = parse_model(text, "held.toml")
    effects = [named("viscous-damping", site="pin", coefficient=2.5)]
    result = simulate(model, TIME, np.empty((151, 0)), initial_state=[0.0], effects=effects, substeps=1)
    assert result.outputs[:, 0] == pytest.approx(-2.5)
