"""A body in MuJoCo is a model like any other: against closed forms, and against the same body as equations."""

import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from mjcf_files import ARM, ARM_EQUATIONS, ARM_TABLE, load, write
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from labrun.compiled import compiled
from labrun.effects import load_effect
from labrun.errors import ModelError
from labrun.models import (
    Stepper,
    corrected_model_text,
    load_model,
    parse_model,
    prepare,
    simulate,
    suggest_substeps,
)

TIME_S = np.linspace(0.0, 3.0, 301)
TORQUE = (0.4 * np.sin(5.0 * TIME_S) + 0.2 * np.sin(17.0 * TIME_S))[:, None]
NOTHING = np.empty((len(TIME_S), 0))
START = [0.4, -1.0]


def bare(joint, inertial, *, options="", more="", gravity="0 0 0"):
    return (
        f'<mujoco><option gravity="{gravity}" {options}/><worldbody><body name="b">{joint}{inertial}</body>'
        f"</worldbody>{more}</mujoco>"
    )


def test_an_oscillator_follows_its_closed_form(tmp_path):
    xml = bare(
        '<joint name="h" axis="0 1 0" stiffness="8" damping="0.3"/>',
        '<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>',
    )
    model = load(tmp_path, 'name = "o"\nmujoco = "arm.xml"\n[outputs]\nangle = "joint.h.position"\n', xml)
    result = simulate(model, TIME_S, NOTHING, initial_state=[0.3, 0.0], substeps=8).outputs[:, 0]
    inertia = 0.02
    decay, speed = 0.3 / (2 * inertia), np.sqrt(8 / inertia - (0.3 / (2 * inertia)) ** 2)
    expected = (
        0.3 * np.exp(-decay * TIME_S) * (np.cos(speed * TIME_S) + decay / speed * np.sin(speed * TIME_S))
    )
    np.testing.assert_allclose(result, expected, atol=2e-7)


def test_a_wide_swing_has_the_period_of_the_elliptic_integral(tmp_path):
    xml = bare(
        '<joint name="h" axis="0 1 0"/>', '<inertial pos="0 0 -0.5" mass="1" diaginertia="1e-6 1e-6 1e-6"/>',
        gravity="0 0 -9.81",
    )  # fmt: skip
    model = load(tmp_path, 'name = "o"\nmujoco = "arm.xml"\n[outputs]\nangle = "joint.h.position"\n', xml)
    amplitude = 2.5
    period = 4 * np.sqrt((0.25 + 1e-6) / (9.81 * 0.5)) * ellipk(np.sin(amplitude / 2) ** 2)
    time_s = np.linspace(0.0, period, 201)
    swing = simulate(model, time_s, np.empty((201, 0)), initial_state=[amplitude, 0.0], substeps=4)
    np.testing.assert_allclose(swing.outputs[[50, 100, 200], 0], [0, -amplitude, amplitude], atol=1e-6)


EFFECTS = {
    "none": [],
    "coulomb-friction": [("coulomb-friction", "joint", "hinge", {"torque": 0.05, "transition_speed": 0.05})],
    "backlash": [("backlash", "joint", "hinge", {"gap": 0.2})],
    "viscoelastic-creep": [("viscoelastic-creep", "joint", "hinge", {"stiffness": 0.4, "time_constant": 0.2})],
    "presliding-friction": [("presliding-friction", "joint", "hinge", {"torque": 0.05, "presliding": 0.02})],
    "load-dependent-friction": [
        ("load-dependent-friction", "joint", "hinge", {"coefficient": 0.01, "transition_speed": 0.05})
    ],
    "added-inertia": [("added-inertia", "joint", "hinge", {"inertia": 0.02})],
    "all at the joint": [
        ("added-inertia", "joint", "hinge", {"inertia": 0.02}),
        ("viscoelastic-creep", "joint", "hinge", {"stiffness": 0.4, "time_constant": 0.2}),
        ("coulomb-friction", "joint", "hinge", {"torque": 0.05, "transition_speed": 0.05}),
    ],
    "delay and lag": [
        ("delay", "input", "torque", {"delay": 0.033}), ("lag", "input", "torque", {"time_constant": 0.05}),
    ],
    "bias": [("bias", "output", "angle", {"offset": 0.01})],
    "all kinds": [
        ("lag", "input", "torque", {"time_constant": 0.05}), ("lag", "output", "angle", {"time_constant": 0.02}),
        ("cross-talk", "output", "angle", {"share": 0.1}), ("hysteresis", "joint", "hinge",
        {"force": 0.1, "yield_displacement": 0.1}),
    ],
}  # fmt: skip


def attached(name):
    return [
        load_effect(effect_id, kind).attach(site, **values) for effect_id, kind, site, values in EFFECTS[name]
    ]


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_act_as_on_the_same_body_given_as_equations(name, tmp_path):
    body = load(tmp_path, ARM_TABLE, ARM)
    equations = parse_model(ARM_EQUATIONS, "arm.toml")
    given = {"initial_state": START, "effects": attached(name), "parameters": {"stiffness": 0.7, "mass": 0.5}}
    expected = simulate(equations, TIME_S, TORQUE, substeps=4, **given)
    result = simulate(body, TIME_S, TORQUE, substeps=4, **given)
    assert result.finite
    np.testing.assert_allclose(result.outputs, expected.outputs, atol=1e-11)
    np.testing.assert_allclose(result.states, expected.states, atol=1e-10)
    assert suggest_substeps(body, TIME_S, TORQUE, **given) == suggest_substeps(
        equations, TIME_S, TORQUE, **given
    )


def test_what_a_model_offers_is_there(tmp_path):
    body, equations = load(tmp_path, ARM_TABLE, ARM), parse_model(ARM_EQUATIONS, "arm.toml")
    for name in ("states", "inputs", "places", "parameters", "conditions"):
        assert getattr(body, name) == getattr(equations, name), name
    assert [output.name for output in body.outputs] == ["angle", "torque"]
    assert body.initial == {"angle": "first", "rate": 0.0}
    assert body.initial_state({}, first={"angle": 0.2}).tolist() == [0.2, 0.0]
    assert body.notes == ()


def test_its_equations_can_be_asked_from_python(tmp_path):
    slopes = []
    for model in (load(tmp_path, ARM_TABLE, ARM), parse_model(ARM_EQUATIONS, "arm.toml")):
        slope, site = np.zeros(2), np.zeros(4)
        arguments = (0.0, np.array(START), np.array([0.3]), model.vector({"mass": 0.6}, {}), np.array([0.1]))
        model.derivative.python(*arguments, slope)
        model.site_values.python(*arguments, site)
        slopes.append([*slope, *site])
    np.testing.assert_allclose(slopes[0], slopes[1], atol=1e-12)


def test_other_values_and_other_inputs_between_samples_are_kept(tmp_path):
    body, equations = load(tmp_path, ARM_TABLE, ARM), parse_model(ARM_EQUATIONS, "arm.toml")
    made = [
        model.with_values({"mass": 0.6}).with_between({"torque": "hold"}).with_effects(attached("backlash"))
        for model in (pickle.loads(pickle.dumps(body)), equations)
    ]
    first, second = [
        simulate(variant, TIME_S, prepare(variant, TIME_S, TORQUE, 2), initial_state=START).outputs
        for variant in made
    ]
    np.testing.assert_allclose(first, second, atol=1e-11)


def test_a_stepper_advances_it_in_blocks(tmp_path):
    body = load(tmp_path, ARM_TABLE, ARM)
    whole = simulate(body, TIME_S, TORQUE, initial_state=START, substeps=1, effects=attached("all kinds"))
    stepper = Stepper(body, effects=attached("all kinds"), step_s=TIME_S[1], initial_state=START)
    parts = [stepper.advance(TORQUE[a : b + 1]) for a, b in ((0, 100), (100, 101), (101, 300))]
    np.testing.assert_allclose(np.concatenate(parts), whole.outputs[1:], atol=1e-9)


def test_a_simulation_depends_on_its_arguments_alone(tmp_path):
    body = load(tmp_path, ARM_TABLE, ARM)
    first = simulate(body, TIME_S, TORQUE, initial_state=START, substeps=2).outputs
    simulate(body, TIME_S, TORQUE, parameters={"mass": 0.9}, initial_state=[1, 1], substeps=2)
    np.testing.assert_array_equal(
        simulate(body, TIME_S, TORQUE, initial_state=START, substeps=2).outputs, first
    )


def _swing(task):
    model, mass = task
    return simulate(model, TIME_S, TORQUE, parameters={"mass": mass}, initial_state=START, substeps=8).outputs


def _cache_hits(body):
    functions = (body.derivative, body.output, body.site_values)
    return [compiled(function.signature, function.provide()).cache_hits for function in functions]


def test_threads_and_processes_get_the_same_numbers_and_another_process_compiles_nothing(tmp_path):
    body = load(tmp_path, ARM_TABLE, ARM)
    tasks = [(body, mass) for mass in np.linspace(0.2, 0.9, 24)]
    alone = [_swing(task) for task in tasks]
    with ThreadPoolExecutor(4) as threads:
        np.testing.assert_array_equal(list(threads.map(_swing, tasks)), alone)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        np.testing.assert_array_equal(list(processes.map(_swing, tasks[:2])), alone[:2])
        assert processes.submit(_cache_hits, body).result() == [1, 1, 1]


def test_added_inertia_is_armature(tmp_path):
    """Also where joints are coupled: the effect sits at one joint of a double pendulum."""
    xml = """<mujoco><worldbody><body><joint name="upper" axis="0 1 0"/>
      <inertial pos="0 0 -0.2" mass="0.3" diaginertia="2e-3 2e-3 2e-3"/>
      <body pos="0 0 -0.4"><joint name="lower" axis="0 1 0" damping="0.01"/>
        <inertial pos="0 0 -0.15" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/></body></body></worldbody></mujoco>"""
    table = """name = "two"\nmujoco = "arm.xml"\n[parameters]\nrotor = { mjcf = "joint.lower.armature", value = 0.0 }
    [outputs]\nupper = "joint.upper.position"\nlower = "joint.lower.position"
    [sites.elbow]\njoint = "lower"\n"""
    model = load(tmp_path, table, xml)
    assert model.states == ("upper_position", "lower_position", "upper_velocity", "lower_velocity")
    given = {"initial_state": [1.0, -0.5, 0.0, 2.0], "substeps": 2}
    inertia = load_effect("added-inertia").attach("elbow", inertia=5e-3)
    np.testing.assert_allclose(
        simulate(model, TIME_S, NOTHING, effects=[inertia], **given).outputs,
        simulate(model, TIME_S, NOTHING, parameters={"rotor": 5e-3}, **given).outputs,
        atol=1e-10,
    )


def test_a_double_pendulum_moves_as_mujoco_itself_moves_it(tmp_path):
    import mujoco

    xml = """<mujoco><option timestep="5e-4" integrator="RK4"/><worldbody><body><joint name="upper" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02"/><body pos="0 0 -0.4">
      <joint name="lower" axis="1 0 0" damping="0.01" stiffness="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/></body></body></worldbody></mujoco>"""
    model = load(tmp_path, 'name="two"\nmujoco="arm.xml"\n[outputs]\nlower="joint.lower.position"\n', xml)
    native = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(native)
    data.qpos[:], data.qvel[:] = [1.0, -0.5], [0.0, 2.0]
    expected = [data.qpos[1]]
    for step in range(2000):
        mujoco.mj_step(native, data)
        if step % 20 == 19:
            expected.append(data.qpos[1])
    time_s = np.linspace(0.0, 1.0, 101)
    result = simulate(model, time_s, np.empty((101, 0)), initial_state=[1.0, -0.5, 0.0, 2.0], substeps=20)
    np.testing.assert_allclose(result.outputs[:, 0], expected, atol=1e-9)


def test_a_spinning_body_follows_eulers_equations(tmp_path):
    xml = bare(
        '<joint name="s" type="ball"/>', '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.02 0.025"/>'
    )
    table = 'name="top"\nmujoco="arm.xml"\n[outputs]\nwx="joint.s.wx"\nqw="joint.s.qw"\nqz="joint.s.qz"\n'
    model = load(tmp_path, table, xml)
    assert model.states == ("s_qw", "s_qx", "s_qy", "s_qz", "s_wx", "s_wy", "s_wz")
    assert model.initial_state({}).tolist() == [1, 0, 0, 0, 0, 0, 0]
    principal = np.array([0.01, 0.02, 0.025])

    def euler(_, x):
        (a, b, c, d), w = x[:4], x[4:]
        turn = [-b * w[0] - c * w[1] - d * w[2], a * w[0] + c * w[2] - d * w[1],
                a * w[1] - b * w[2] + d * w[0], a * w[2] + b * w[1] - c * w[0]]  # fmt: skip
        return [*(0.5 * np.array(turn)), *(np.cross(principal * w, w) / principal)]

    start = [1.0, 0, 0, 0, 0.3, 4.0, 0.2]
    exact = solve_ivp(euler, (0, 3), start, t_eval=TIME_S, rtol=1e-11, atol=1e-12).y
    outputs = simulate(model, TIME_S, NOTHING, initial_state=start, substeps=8).outputs
    np.testing.assert_allclose(outputs, exact[[4, 0, 3]].T, atol=1e-7)


def test_a_free_body_answers_to_gravity_and_to_a_force(tmp_path):
    xml = bare(
        '<freejoint name="f"/>', '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>', gravity="0 0 -9.81"
    )
    table = """name="body"\nmujoco="arm.xml"\n[inputs]\npush="body.b.force[0]"\n[parameters]
    g = { mjcf = "option.gravity[2]", unit = "m/s^2" }\n[outputs]\nx="body.b.position[0]"\nz="joint.f.z"
    [initial]\nf_vx = "speed"\n"""
    model = load(tmp_path, table, xml)
    assert model.parameters[0].value == -9.81
    push = np.full((len(TIME_S), 1), 3.0)
    outputs = simulate(
        model, TIME_S, push, parameters={"g": -2.0}, condition={"speed": 0.5}, substeps=1
    ).outputs
    np.testing.assert_allclose(
        outputs, np.column_stack([0.5 * TIME_S + 0.75 * TIME_S**2, -(TIME_S**2)]), atol=1e-10
    )


def test_an_actuator_with_memory_is_a_state(tmp_path):
    more = """<actuator><general name="muscle" joint="h" dyntype="filter" dynprm="0.2" gainprm="1"/></actuator>
    <sensor><jointactuatorfrc name="drive" joint="h"/><jointvel name="gyro" joint="h"/></sensor>"""
    xml = bare(
        '<joint name="h" axis="0 0 1"/>', '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>', more=more
    )
    table = """name="m"\nmujoco="arm.xml"\n[inputs]\nu="actuator.muscle"
    [parameters]\ntau = { mjcf = "actuator.muscle.dynprm[0]", unit = "s" }
    [outputs]\nforce="actuator.muscle.force"\ndrive="sensor.drive"\nspeed="sensor.gyro"\nacc="joint.h.acceleration"\n"""
    model = load(tmp_path, table, xml)
    assert model.states[-1] == "muscle_activation"
    outputs = simulate(model, TIME_S, np.ones((301, 1)), parameters={"tau": 0.5}, substeps=2).outputs
    force = 1 - np.exp(-TIME_S / 0.5)
    np.testing.assert_allclose(outputs[:, [0, 1, 3]], np.column_stack([force] * 3), atol=1e-9)
    np.testing.assert_allclose(outputs[:, 2], TIME_S - 0.5 * force, atol=1e-9)


def test_a_servos_gains_are_parameters(tmp_path):
    more = '<actuator><position name="servo" joint="h" kp="3" kv="0.1"/></actuator>'
    xml = bare(
        '<joint name="h" axis="0 0 1"/>', '<inertial pos="0 0 0" mass="1" diaginertia="1 1 0.5"/>', more=more
    )
    table = """name="s"\nmujoco="arm.xml"\n[inputs]\ngoal="actuator.servo"\n[parameters]
    kp = { mjcf = "actuator.servo.kp" }\nkv = { mjcf = "actuator.servo.kv" }\n[outputs]\nangle="joint.h.position"\n"""
    model = load(tmp_path, table, xml)
    assert [parameter.value for parameter in model.parameters] == [3.0, 0.1]
    equations = parse_model(
        'name="s"\nstates=["a","b"]\ninputs=["goal"]\n[parameters]\nkp=3\nkv=0.1\n[equations]\na="b"\n'
        'b="(kp*(goal-a)-kv*b)/0.5"\n[outputs]\nangle="a"\n', "s.toml",
    )  # fmt: skip
    first, second = [
        simulate(
            other, TIME_S, TORQUE, parameters={"kp": 5.0, "kv": 0.7}, initial_state=[0.1, 0.0], substeps=2
        ).outputs
        for other in (model, equations)
    ]
    np.testing.assert_allclose(first, second, atol=1e-11)


def test_a_centre_of_mass_can_be_moved(tmp_path):
    xml = bare(
        '<joint name="h" axis="0 1 0"/>', '<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/>',
        gravity="0 0 -9.81",
    )  # fmt: skip
    table = 'name="c"\nmujoco="arm.xml"\n[parameters]\nr=0.2\n[mjcf]\n"body.b.ipos[2]"="-r"\n'
    table += '[outputs]\na="joint.h.position"\n'
    model = load(tmp_path, table, xml)
    equations = parse_model(
        'name="c"\nstates=["a","b"]\n[parameters]\nr=0.2\n[equations]\na="b"\nb="-9.81*r*sin(a)/(0.01+r^2)"\n'
        '[outputs]\na="a"\n', "c.toml",
    )  # fmt: skip
    first, second = [
        simulate(other, TIME_S, NOTHING, parameters={"r": 0.05}, initial_state=[0.4, 0.0], substeps=4).outputs
        for other in (model, equations)
    ]
    np.testing.assert_allclose(first, second, atol=1e-11)


@pytest.mark.parametrize("option", ["density", "viscosity"])
def test_the_fluid_is_a_parameter(option, tmp_path):
    body = '<geom type="box" size="0.1 0.02 0.1" pos="0 0 -0.2" mass="0.5"/>'
    still = bare('<joint name="h" axis="0 1 0"/>', body, gravity="0 0 -9.81")
    wet = bare('<joint name="h" axis="0 1 0"/>', body, gravity="0 0 -9.81", options=f'{option}="30"')
    table = 'name="w"\nmujoco="arm.xml"\n[outputs]\na="joint.h.position"\n'
    setting = f'[parameters]\nwater = {{ mjcf = "option.{option}", value = 0.0 }}\n'
    (tmp_path / "wet").mkdir()
    models = [load(tmp_path, table + setting, still), load(tmp_path / "wet", table, wet)]
    given = {"initial_state": [1.0, 0.0], "substeps": 2}
    air = simulate(models[0], TIME_S, NOTHING, **given).outputs
    water = simulate(models[0], TIME_S, NOTHING, parameters={"water": 30.0}, **given).outputs
    np.testing.assert_allclose(water, simulate(models[1], TIME_S, NOTHING, **given).outputs, atol=1e-12)
    assert np.abs(water - air).max() > 0.01


def test_parameters_cannot_be_swapped_for_others(tmp_path):
    model = load(tmp_path, ARM_TABLE, ARM)
    with pytest.raises(ModelError, match="takes 3 parameters and conditions, and now has 2"):
        simulate(replace(model, parameters=model.parameters[1:]), TIME_S, TORQUE, initial_state=START)


def test_attributes_may_follow_from_a_trials_condition(tmp_path):
    table = ARM_TABLE.replace("[outputs]", '[mjcf]\n"joint.hinge.armature" = "rotor_g_cm2*1e-7"\n[outputs]')
    model = load(tmp_path, table, ARM)
    assert model.conditions == ("rotor_g_cm2",)
    inertia = load_effect("added-inertia").attach("hinge", inertia=0.02)
    given = {"initial_state": START, "substeps": 2}
    np.testing.assert_allclose(
        simulate(model, TIME_S, TORQUE, condition={"rotor_g_cm2": 2e5}, **given).outputs[:, 0],
        simulate(model, TIME_S, TORQUE, condition={"rotor_g_cm2": 0}, effects=[inertia], **given).outputs[
            :, 0
        ],
        atol=1e-10,
    )


def test_a_ball_that_falls_on_a_floor_stays_there(tmp_path):
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="ball" pos="0 0 0.3">
      <joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size="0.1" mass="1"/></body></worldbody>
      </mujoco>"""
    table = 'name="ball"\nmujoco="arm.xml"\n[outputs]\nheight="body.ball.position[2]"\n'
    model = load(tmp_path, table, xml)
    result = simulate(model, TIME_S, NOTHING, substeps=16)
    assert result.finite
    assert result.outputs[0, 0] == pytest.approx(0.3)
    assert result.outputs[-1, 0] == pytest.approx(0.1, abs=2e-3)
    np.testing.assert_array_equal(simulate(model, TIME_S, NOTHING, substeps=16).outputs, result.outputs)


@pytest.mark.parametrize(
    "parameters",
    [{"mass": np.nan}, {"mass": np.inf}, {"mass": -1.0}, {"damping": -50.0}, {"damping": np.nan}],
    ids=str,
)
def test_impossible_parameters_end_a_simulation_and_nothing_else(parameters, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = load(tmp_path, ARM_TABLE, ARM)
    blown = simulate(model, TIME_S, TORQUE, parameters=parameters, initial_state=START)
    assert not blown.finite
    assert np.isnan(blown.outputs[-1]).all()
    assert simulate(model, TIME_S, TORQUE, initial_state=START, substeps=1).finite
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.toml", "arm.xml"]


def test_its_corrected_model_refers_to_it(tmp_path):
    path = write(tmp_path, ARM_TABLE, ARM)
    model = load_model(path)
    (tmp_path / "better").mkdir()
    effects = attached("all at the joint")
    text = corrected_model_text(model, path, {"mass": 0.43}, effects, "fitted", folder=tmp_path / "better")
    assert 'base = "../arm.toml"' in text
    (tmp_path / "better" / "arm.toml").write_text(text)
    better = load_model(tmp_path / "better" / "arm.toml")
    given = {"initial_state": START, "substeps": 2}
    np.testing.assert_array_equal(
        simulate(better, TIME_S, TORQUE, **given).outputs,
        simulate(model, TIME_S, TORQUE, parameters={"mass": 0.43}, effects=effects, **given).outputs,
    )


def test_the_shipped_body_swings_as_its_equations_say():
    body, equations = load_model("hinge-pendulum-mujoco"), load_model("hinge-pendulum")
    values = {"inertia": 4.1e-5, "gravity_torque": 6.4e-3, "stiffness": 0.02, "damping": 6e-5}
    for parameters in (None, values):
        first, second = [
            simulate(
                model, TIME_S, NOTHING, parameters=parameters, initial_state=[1.0, 0.0], substeps=4
            ).outputs
            for model in (body, equations)
        ]
        np.testing.assert_allclose(first, second, atol=1e-11)
