"""The exported MJCF, simulated by MuJoCo alone, does what labrun's own corrected simulation does."""

import mujoco
import numpy as np
import pytest

from labrun.errors import ModelError
from labrun.models import (
    load_model,
    mjcf_of,
    mjcf_ranges,
    passive_forces,
    read_robot,
    robot_table,
    simulate,
)

ARM = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.2" stiffness="1"/>
<inertial pos="0 0 -.1" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator><position name="servo" joint="shoulder" kp="8"/></actuator></mujoco>
"""
NOISE_RAD = 1e-3
"""What an encoder of 4096 steps a turn shows at least: the floor below which two simulations are the same."""
EFFECTS = {
    "coulomb-friction": ("joint", "shoulder", {"torque": 0.05, "transition_speed": 0.003}, "frictionloss"),
    "viscous-damping": ("joint", "shoulder", {"coefficient": 0.15}, "damping"),
    "quadratic-drag": ("joint", "shoulder", {"coefficient": 0.1}, "damping"),
    "added-inertia": ("joint", "shoulder", {"inertia": 0.004}, "armature"),
    "rest-offset": ("joint", "shoulder", {"offset": 0.2}, "springref"),
    "constant-force": ("joint", "shoulder", {"force": 0.6}, "biasprm"),
    "asymmetric-stiffness": ("joint", "shoulder", {"excess": 5.0}, "solreflimit"),
    "end-stop": (
        "joint",
        "shoulder",
        {"upper": 0.3, "lower": "-inf", "stiffness": 20.0, "damping_time": 0.0},
        "solreflimit",
    ),
    "delay": ("input", "shoulder_command", {"delay": 0.03}, "delay"),
    "gain-error": ("input", "shoulder_command", {"error": -0.2}, "gainprm"),
    "bias": ("input", "shoulder_command", {"offset": 0.1}, "biasprm"),
    "lag": ("input", "shoulder_command", {"time_constant": 0.05}, "dynprm"),
    "saturation": ("input", "shoulder_command", {"level": 0.4, "knee": 0.0}, "ctrlrange"),
}


def corrected(folder, effects, values=""):
    """Return the model of the arm with effects, as a diagnosis saves it."""
    (folder / "arm.xml").write_text(ARM)
    lines = ['base = "arm.xml"', "[values]", values]
    for name in effects:
        kind, site, numbers, _ = EFFECTS[name]
        message = ", ".join(f"{key} = {value}" for key, value in numbers.items())
        lines += [
            "[[effects]]",
            f'effect = "{name}"',
            f'site = "{site}"',
            f'kind = "{kind}"',
            f"values = {{ {message} }}",
        ]
    (folder / "corrected.toml").write_text("\n".join(lines) + "\n")
    return load_model(folder / "corrected.toml")


def both(model, xml, callback=None):
    """Return what labrun and MuJoCo alone say of a swing, at 100 Hz; a callback is set once the file is loaded."""
    time_s = np.arange(0.0, 3.0, 0.01)
    goal = 0.7 * np.sin(2 * np.pi * 0.7 * time_s)
    own = simulate(model, time_s, goal[:, None], initial_state=[0.0, 0.0]).outputs[:, 0]
    native = mujoco.MjModel.from_xml_string(xml)
    data, alone = mujoco.MjData(native), []
    mujoco.set_mjcb_passive(callback)
    try:
        for command in goal:
            alone.append(float(data.qpos[0]))
            data.ctrl[0] = command
            for _ in range(round(0.01 / native.opt.timestep)):
                mujoco.mj_step(native, data)
    finally:
        mujoco.set_mjcb_passive(None)
    return own, np.array(alone)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_that_mjcf_has_a_word_for_moves_mujoco_alike(tmp_path, name):
    model = corrected(tmp_path, [name], "shoulder_damping = 0.25")
    exported = mjcf_of(model)
    assert not exported.left
    assert EFFECTS[name][3] in " ".join(exported.written)
    own, alone = both(model, exported.xml)
    untouched, _ = both(load_model(tmp_path / "arm.xml"), ARM)
    assert np.sqrt(np.mean((own - untouched) ** 2)) > 5 * NOISE_RAD, "the correction is to be seen at all"
    assert np.sqrt(np.mean((own - alone) ** 2)) < NOISE_RAD


def test_values_and_several_effects_go_together(tmp_path):
    model = corrected(
        tmp_path,
        ["coulomb-friction", "delay", "added-inertia"],
        "servo_kp = 8.7\nupper_mass = 0.33\nshoulder_damping = 0.3",
    )
    exported = mjcf_of(model)
    own, alone = both(model, exported.xml)
    assert np.sqrt(np.mean((own - alone) ** 2)) < NOISE_RAD
    assert "body_mass of upper: 0.3 became 0.33" in exported.written


TWO_LINKS = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 0 1" damping="0.2"/>
<inertial pos="0.15 0 0" mass="0.6" diaginertia="1e-3 3e-3 3e-3"/>
<body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"/>
<inertial pos="0.1 0 0" mass="0.3" diaginertia="4e-4 1e-3 1e-3"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="8"/><position name="elbow" joint="elbow" kp="6"/></actuator>
</mujoco>
"""


def turned(xml, roll, pitch, load, load_at):
    """Return MuJoCo's own model of the arm on a turned base, with a ball on its last link."""
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.option.timestep = False, 0.001
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    base = spec.worldbody.add_body(name="base", euler=[roll, 0, 0]).add_body(euler=[0, pitch, 0])
    spec.attach(mujoco.MjSpec.from_string(xml), frame=base.add_frame(), prefix="in-")
    tip = spec.body("in-lower").add_body(pos=load_at)
    tip.mass, tip.ipos, tip.inertia, tip.explicitinertial = load, [0, 0, 0], [1e-9] * 3, True
    return spec.compile()


def moved(native, joints):
    """Return the joints' angles at 100 Hz, goals as sines from rest."""
    data, angles = mujoco.MjData(native), []
    controls = [native.actuator(name).id for name in joints]
    places = [native.joint(name).qposadr[0] for name in joints]
    time_s = np.arange(0.0, 3.0, 0.01)
    goals = np.column_stack([0.7 * np.sin(2 * np.pi * 0.7 * time_s), 0.5 * np.sin(2 * np.pi * 0.4 * time_s)])
    for goal in goals:
        angles.append(data.qpos[places].copy())
        data.ctrl[controls] = goal
        mujoco.mj_step(native, data, nstep=10)
    return time_s, goals, np.array(angles)


@pytest.mark.parametrize("load_at", [(0.2, 0.0, 0.0), (0.14, 0.05, 0.0)])
def test_a_tilted_base_and_a_load_are_in_the_exported_file(tmp_path, load_at):
    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    at = "".join(f"tip_load_{axis} = {value}\n" for axis, value in zip("xyz", load_at, strict=True))
    (tmp_path / "corrected.toml").write_text(
        f'base = "arm.xml"\n[values]\nbase_roll = 0.08\nbase_pitch = -0.06\ntip_load = 0.12\n{at}'
    )
    model = load_model(tmp_path / "corrected.toml")
    exported = mjcf_of(model)
    assert not exported.left
    joints = ["shoulder", "elbow"]
    time_s, goals, alone = moved(mujoco.MjModel.from_xml_string(exported.xml), joints)
    begin = np.zeros(4)
    own = simulate(model, time_s, goals, initial_state=begin).outputs
    _, _, level = moved(mujoco.MjModel.from_xml_string(TWO_LINKS), joints)
    _, _, real = moved(turned(TWO_LINKS, 0.08, -0.06, 0.12, load_at), ["in-shoulder", "in-elbow"])
    assert np.sqrt(np.mean((level - real) ** 2, axis=0)).min() > 5 * NOISE_RAD, "both are to be seen at all"
    assert np.sqrt(np.mean((alone - own) ** 2)) < NOISE_RAD
    assert np.sqrt(np.mean((real - own) ** 2)) < NOISE_RAD


def test_what_has_no_word_in_mjcf_is_listed_with_its_law(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "corrected.toml").write_text(
        'base = "arm.xml"\n[[effects]]\neffect = "cubic-stiffness"\nsite = "shoulder"\nkind = "joint"\n'
        'values = { coefficient = 2.0 }\n[[effects]]\neffect = "delay"\nsite = "shoulder"\nkind = "output"\n'
        'values = { delay = 0.01 }\n[[effects]]\neffect = "late-clock"\nsite = "shoulder_command"\nkind = "input"\n'
        "values = { lead = 0.03 }\n"
    )
    law, sensor, clock = mjcf_of(load_model(tmp_path / "corrected.toml")).left
    assert "cubic-stiffness at shoulder has no word in MJCF: F = -coefficient*q^3" in law
    assert "with coefficient = 2" in law
    assert "belongs to the sensor" in sensor
    assert "late-clock at shoulder_command is a clock of the log, and no part of the robot" in clock


def test_a_body_that_is_heavier_turns_less_easily_in_proportion_and_is_told_by_its_mass(tmp_path):
    exported = mjcf_of(corrected(tmp_path, [], "upper_mass = 0.33"))
    before, after = (mujoco.MjModel.from_xml_string(xml).body("upper") for xml in (ARM, exported.xml))
    assert after.mass[0] == pytest.approx(0.33)
    assert after.inertia == pytest.approx(1.1 * before.inertia, rel=1e-6)
    assert exported.written == ("body_mass of upper: 0.3 became 0.33",)


def test_intervals_are_told_as_the_numbers_of_mjcf(tmp_path):
    model = corrected(tmp_path, [])
    ranges = mjcf_ranges(model, {"servo_kp": (8.0, 7.5, 8.5), "upper_mass": (0.3, 0.29, 0.31)})
    assert [(r.array, r.element, r.joint, r.low, r.high) for r in ranges] == [
        ("actuator_gainprm", "servo", "shoulder", 7.5, 8.5), ("body_mass", "upper", "", 0.29, 0.31),
    ]  # fmt: skip


def test_a_model_of_equations_has_no_mjcf(tmp_path):
    (tmp_path / "a.toml").write_text(
        'name = "a"\nstates = ["x"]\n[equations]\nx = "-x"\n[outputs]\nx = "x"\n'
    )
    with pytest.raises(ModelError, match="not a model in MuJoCo"):
        mjcf_of(load_model(tmp_path / "a.toml"))


def test_a_delay_is_written_in_seconds_and_holds_at_shorter_time_steps(tmp_path):
    model = corrected(tmp_path, ["delay"])
    exported = mjcf_of(model)
    assert "delay of actuator servo: 0.03 s" in exported.xml
    assert "timesteps of 0.0001 s and more" in exported.xml
    spec = mujoco.MjSpec.from_string(exported.xml)
    spec.option.timestep = 2e-4
    own, alone = both(model, spec.to_xml())
    assert np.sqrt(np.mean((own - alone) ** 2)) < NOISE_RAD


def test_a_file_that_keeps_too_few_samples_for_its_delay_is_told(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(ARM.replace('kp="8"', 'kp="8" delay="0.03" nsample="12"'))
    message = " ".join(read_robot(file).remarks)
    assert (
        "at the file's timestep of 0.001 s MuJoCo cuts its delay of 0.03 s off; set nsample to 31" in message
    )


def test_gravity_compensation_is_gravcomp_of_the_bodies(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.replace('pos="0 0 -.1"', 'pos=".3 0 -.1"'))
    model = load_model(tmp_path / "arm.xml")
    held = model.with_values({"gravity_compensation": 0.8})
    exported = mjcf_of(held)
    assert exported.written == ("gravity compensation of 0.8 is gravcomp of upper",)
    own, alone = both(held, exported.xml)
    without, _ = both(model, mjcf_of(model).xml)
    assert np.sqrt(np.mean((own - without) ** 2)) > 5 * NOISE_RAD, "the compensation is to be seen at all"
    assert np.sqrt(np.mean((own - alone) ** 2)) < NOISE_RAD
    assert "gravcomp" not in mjcf_of(model).xml


PASSIVE = {
    "cubic-stiffness": "{ coefficient = 6.0 }",
    "presliding-friction": "{ torque = 0.8, presliding = 0.05, static_excess = 0.2, stribeck_speed = 0.3 }",
    "drive-play": "{ torque = 0.6 }",
}


@pytest.mark.parametrize("name", PASSIVE)
def test_a_force_that_mjcf_has_no_word_for_is_a_passive_callback(tmp_path, name):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "model.toml").write_text(robot_table(read_robot(tmp_path / "arm.xml"), xml_file="arm.xml"))
    (tmp_path / "corrected.toml").write_text(
        f'base = "model.toml"\n[[effects]]\neffect = "{name}"\nsite = "shoulder"\nkind = "joint"\n'
        f"values = {PASSIVE[name]}\n"
    )
    model = load_model(tmp_path / "corrected.toml")
    exported = mjcf_of(model)
    assert "labrun.models.passive_forces makes a callback of it" in exported.left[0]
    own, alone = both(model, exported.xml, passive_forces(model))
    _, without = both(model, exported.xml)
    assert np.sqrt(np.mean((own - without) ** 2)) > 5 * NOISE_RAD, "the force is to be seen at all"
    assert np.sqrt(np.mean((own - alone) ** 2)) < NOISE_RAD


def test_a_file_that_says_everything_needs_no_callback(tmp_path):
    with pytest.raises(ModelError, match="has no force that its MJCF cannot express"):
        passive_forces(corrected(tmp_path, ["coulomb-friction"]))
