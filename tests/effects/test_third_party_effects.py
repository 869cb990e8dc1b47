"""Effects of one's own: a force law with an internal state, and a filter that sees a neighbouring signal."""

import math

import numpy as np
import pytest
from rig import MODEL, named
from scipy.integrate import solve_ivp

from labrun.effects import Effect, EffectParameter, force_law, load_effect, signal_filter
from labrun.models import parse_model, simulate


def creeping_spring(t, q, rate, acceleration, load, stiffness, values, z, dz):
    dz[0] = (q - z[0]) / values[1]
    return -values[0] * (q - z[0])


MAXWELL = Effect(
    id="maxwell-branch",
    kind="joint",
    parameters=(
        EffectParameter("stiffness", "stiffness", neutral=0.0, lower=0.0, upper=1.0, starts=(0.1,)),
        EffectParameter("relaxation", "time", neutral=None, lower=0.01, upper=10.0, starts=(0.5,)),
    ),
    function=force_law(creeping_spring),
    form="F = -stiffness (q - z), relaxation dz/dt = q - z",
    source="Maxwell 1867",
    states=1,
)


def leak(before, after, dt, values, memory, out):
    out[0] = before[0] + values[0] * before[1]
    out[1] = after[0] + values[0] * after[1]


CROSS_TALK = Effect(
    id="neighbour",
    kind="output",
    parameters=(EffectParameter("share", "ratio", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1,)),),
    function=signal_filter(leak),
    form="y = signal + share neighbour",
    source="test",
)


def sick(t, q, rate, acceleration, load, stiffness, values, z, dz):
    return math.nan


SICK = Effect("sick", "joint", (), force_law(sick), "F = nan", "test")


def test_an_effect_with_a_state_of_its_own_is_integrated_with_the_model():
    effect = load_effect(f"{__name__}:MAXWELL").attach("hinge", stiffness=20.0, relaxation=0.4)
    time_s = np.linspace(0, 3, 151)
    result = simulate(
        MODEL, time_s, np.zeros((151, 2)), effects=[named("viscous-damping"), effect, effect], substeps=16
    )

    def slope(_, x):
        spring = 2 * 20.0 * (x[0] - x[2])
        damping = 0.8 + 0.05
        return x[1], (-50 * x[0] - damping * x[1] - spring) / 2, (x[0] - x[2]) / 0.4

    exact = solve_ivp(slope, (0, 3), [0.3, 0.0, 0.0], "DOP853", time_s, rtol=1e-11, atol=1e-12).y[0]
    assert result.outputs[:, 0] == pytest.approx(exact, abs=1e-7)
    assert result.states.shape == (151, 2)


def test_a_filter_sees_the_other_signals_of_its_kind():
    model = parse_model(
        'name = "w"\ninputs = ["a", "b", "c"]\n[outputs]\nx = "a"\ny = "b"\nz = "c"', "w.toml"
    )
    u = np.random.default_rng(0).normal(size=(20, 3))
    for site, own, neighbour in (("x", 0, 1), ("y", 1, 0), ("z", 2, 0)):
        out = simulate(
            model, np.arange(20.0), u, effects=[CROSS_TALK.attach(site, share=0.25)], substeps=2
        ).outputs
        assert out[:, own] == pytest.approx(u[:, own] + 0.25 * u[:, neighbour])


def test_a_law_that_gives_nan_makes_the_simulation_not_finite():
    result = simulate(MODEL, np.arange(5.0), np.zeros((5, 2)), effects=[SICK.attach("hinge")], substeps=1)
    assert not result.finite
