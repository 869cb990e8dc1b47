import numpy as np
import pytest
from rig import MODEL, named
from scipy.integrate import solve_ivp

from labrun.effects import Scale
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
        (
            named(
                "stribeck-friction", torque=0.5, static_excess=1.2, stribeck_speed=0.3, transition_speed=0.02
            ),
            lambda q, v: -(0.5 + 0.6 * np.exp(-((v / 0.3) ** 2))) * np.tanh(v / 0.02),
        ),
        (
            named("asymmetric-friction", torque=1.0, asymmetry=-0.6, transition_speed=0.02),
            lambda q, v: -(1 - 0.6 * np.tanh(v / 0.02)) * np.tanh(v / 0.02),
        ),
        (
            named("load-dependent-friction", coefficient=0.2, transition_speed=0.02),
            lambda q, v: -0.2 * abs(3 * np.cos(q)) * np.tanh(v / 0.02),
        ),
        (named("asymmetric-stiffness", excess=30.0), lambda q, v: -30 * max(q, 0.0)),
        (named("backlash", gap=0.1), lambda q, v: 50 * np.clip(q, -0.05, 0.05)),
        (
            named("end-stop", upper=0.1, lower=-0.05, stiffness=400.0),
            lambda q, v: -400 * (max(q - 0.1, 0.0) + min(q + 0.05, 0.0)),
        ),
        (
            named("reynolds-dependent-drag", "body", coefficient=2.0, exponent=0.5, reference=1.0),
            lambda q, v: -2.0 * abs(0.1 * v) ** 1.5 * np.sign(v),
        ),
        (
            named("mean-current", "body", coefficient=40.0, speed=0.05),
            lambda q, v: 40 * (0.01 * abs(v) * v - abs(0.1 * v - 0.05) * (0.1 * v - 0.05)),
        ),
    ],
    ids=lambda case: getattr(getattr(case, "effect", None), "id", ""),
)
def test_a_force_law_moves_the_joint_as_scipy_says(effect, force):
    result = simulate(MODEL, TIME, DRIVE, effects=[effect], substeps=64)
    assert result.outputs[:, 0] == pytest.approx(_exact(force), abs=2e-6)


def _late_by(delay, signal, z):
    """Return a signal behind four Pade approximations of a quarter of the delay each, and the rates of their states."""
    part, rates = delay / 4, []
    for first, second in zip(z[0::2], z[1::2], strict=True):
        rates += [second, signal - 12 / part**2 * first - 6 / part * second]
        signal = signal - 12 / part * second
    return signal, rates


def _exact_with_memory(force, memory, states):
    """Return the angle where a force has states of its own: ``force(q, v, z)``, ``dz/dt = memory(q, v, z)``."""

    def slope(_, x):
        q, v, z = x[0], x[1], x[2:]
        return v, (-STIFFNESS * q - DAMPING * v + force(q, v, z)) / INERTIA, *memory(q, v, z)

    start = [0.3, 0.0, *([0.0] * states)]
    return solve_ivp(slope, (0, 3), start, "DOP853", TIME, rtol=1e-10, atol=1e-12, max_step=0.002).y[0]


@pytest.mark.parametrize(
    ("effect", "force", "memory", "states"),
    [
        (
            named("viscoelastic-creep", stiffness=20.0, time_constant=0.4),
            lambda q, v, z: -20 * (q - z[0]),
            lambda q, v, z: [(q - z[0]) / 0.4],
            1,
        ),
        (
            named("hysteresis", force=2.0, yield_displacement=0.05),
            lambda q, v, z: -2 * z[0],
            lambda q, v, z: [v * (1 - z[0] ** 2 * (1 + np.sign(v * z[0])) / 2) / 0.05],
            1,
        ),
        (
            named(
                "presliding-friction",
                torque=1.0,
                presliding=0.02,
                static_excess=0.4,
                stribeck_speed=0.2,
                damping_time=0.002,
            ),
            lambda q, v, z: (
                -(z[0] + 0.002 * (v - abs(v) * z[0] / (1 + 0.4 * np.exp(-((v / 0.2) ** 2)))) / 0.02)
            ),
            lambda q, v, z: [(v - abs(v) * z[0] / (1 + 0.4 * np.exp(-((v / 0.2) ** 2)))) / 0.02],
            1,
        ),
        (
            named("wall-echo", "body", coefficient=30.0, delay=0.3),
            lambda q, v, z: 30 * _late_by(0.3, 0.01 * abs(v) * v, z)[0],
            lambda q, v, z: _late_by(0.3, 0.01 * abs(v) * v, z)[1],
            8,
        ),
    ],
    ids=lambda case: getattr(getattr(case, "effect", None), "id", ""),
)
def test_a_force_law_with_memory_moves_the_joint_as_scipy_says(effect, force, memory, states):
    result = simulate(MODEL, TIME, DRIVE, effects=[effect], substeps=64)
    assert result.outputs[:, 0] == pytest.approx(_exact_with_memory(force, memory, states), abs=3e-6)


@pytest.mark.parametrize("delay", [0.0005, 0.002, 0.004, 0.006, 0.02])
def test_a_drive_comes_late_by_delays_of_the_integrators_steps_and_less(delay):
    """Below 8 ms to (delay (8 ms - delay) omega^2) / 2 of its size, which is at most 8e-4 here."""
    text = (
        'name = "probe"\nstates = ["q"]\ninputs = ["u"]\n[equations]\nq = "u + 0*force.knee"\n'
        '[outputs]\narrived = "u + force.knee"\n'
        '[sites.knee]\nkind = "joint"\ncoordinate = "q"\nrate = "u"\nload = "u"\ndrive = true\n'
    )
    model = parse_model(text, "probe.toml")
    time_s, omega = np.arange(0, 4, 0.01), 10.0
    late = named("loop-delay", site="knee", delay=delay)
    drive = np.sin(omega * time_s)[:, None]
    result = simulate(model, time_s, drive, initial_state=[0.0], effects=[late], substeps=4)
    wanted = np.sin(omega * (time_s - delay))
    assert result.outputs[50:, 0] == pytest.approx(wanted[50:], abs=2e-3)


@pytest.mark.parametrize("omega", [0.8, 4.0, 6.0])
def test_an_echo_comes_back_one_delay_later(omega):
    """Up to an angular frequency of 7 / delay (of the square: 3.5) the Pade approximations are the delay itself."""
    text = (
        'name = "probe"\nstates = ["q"]\ninputs = ["v"]\n[equations]\nq = "v + 0*force.fin"\n'
        '[outputs]\nechoed = "force.fin"\n[sites.fin]\nkind = "body"\ncoordinate = "q"\nrate = "v"\n'
    )
    model = parse_model(text, "probe.toml")
    time_s = np.arange(0, 20, 0.01)
    drive = 2.0 + np.sin(omega * time_s)
    echo = named("wall-echo", "body", site="fin", coefficient=1.0, delay=0.5)
    result = simulate(model, time_s, drive[:, None], initial_state=[0.0], effects=[echo], substeps=4)
    late = (2.0 + np.sin(omega * (time_s - 0.5))) ** 2
    tolerance = 2e-3 if omega < 1 else 0.2  # of 1 to 9
    assert result.outputs[500:, 0] == pytest.approx(late[500:], abs=tolerance)


@pytest.mark.parametrize(
    "friction",
    [
        named("presliding-friction", torque=2.0, presliding=0.01, damping_time=0.01),
        named("coulomb-friction", torque=2.0, presliding=0.01),
        named("asymmetric-friction", torque=2.0, asymmetry=0.0, presliding=0.01),
        named("stribeck-friction", torque=2.0, static_excess=0.0, stribeck_speed=0.1, presliding=0.01),
    ],
    ids=lambda case: case.effect.id,
)
def test_bristles_give_way_like_a_softening_spring_before_they_slide(friction):
    """Pushed slowly, the joint gives way by presliding * ln(1 / (1 - push / torque)), and stays there."""
    time_s = np.linspace(0, 20, 2001)
    push = np.column_stack(
        [0.4 * np.minimum(time_s / 18, 1.0), np.zeros(2001)]
    )  # slowly, or it would overshoot and slide
    result = simulate(
        MODEL,
        time_s,
        push,
        parameters={"stiffness": 0.0},
        initial_state=[0.0, 0.0],
        effects=[friction],
        substeps=16,
    )
    assert result.outputs[-1, 0] == pytest.approx(0.01 * np.log(1 / (1 - 0.4 / 2.0)), rel=0.05)


@pytest.mark.parametrize("presliding", [1e-9, 1e-6])
def test_bristles_shorter_than_a_step_hold_like_a_sharp_sign(presliding):
    """A step goes a thousand times as far: explicit integration would blow up, had the bristles no end."""
    bristles = named("coulomb-friction", torque=1.0, presliding=presliding)
    sign = named("coulomb-friction", torque=1.0, transition_speed=5e-4)
    first, other = (
        simulate(MODEL, TIME, DRIVE, effects=[effect], substeps=256).outputs for effect in (bristles, sign)
    )
    assert first == pytest.approx(other, abs=2e-3)


def test_a_stop_pushes_and_never_pulls():
    stop = named("end-stop", upper=0.05, lower=-10.0, stiffness=1e4, damping_time=0.5)
    angle = simulate(MODEL, TIME, DRIVE, effects=[stop], initial_state=[0.0, 1.0], substeps=64).outputs[:, 0]
    free = simulate(MODEL, TIME, DRIVE, initial_state=[0.0, 1.0], substeps=64).outputs[:, 0]
    assert angle.max() < 0.07 < free.max()
    assert angle.min() < -0.05


@pytest.mark.parametrize("mass", [-0.1, 0.5])
def test_added_mass_of_a_body_is_inertia_at_its_lever(mass):
    effect = simulate(MODEL, TIME, DRIVE, effects=[named("added-mass", "body", mass=100 * mass)], substeps=4)
    # the blade moves 0.1 m/rad, and its force counts as it stands: the joint gets mass * 0.1 of inertia
    value = simulate(MODEL, TIME, DRIVE, parameters={"inertia": INERTIA + 10 * mass}, substeps=4)
    assert effect.outputs == pytest.approx(value.outputs, abs=1e-11)


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


def test_the_damping_of_a_stop_is_a_time_per_coordinate_so_that_force_has_one_unit() -> None:
    stop = named("end-stop").effect
    damping = next(parameter for parameter in stop.parameters if parameter.name == "damping_time")
    assert (damping.unit("rad"), damping.unit("m")) == ("s/rad", "s/m")
    assert damping.bounds(Scale(rate=4.0)) == (0.0, 0.25)
