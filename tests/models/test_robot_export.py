"""The exported MJCF, simulated by MuJoCo alone, does what labrun's own corrected simulation does."""

import numpy as np
import pytest

from labrun.errors import ModelError
from labrun.models import load_model, mjcf_of, mjcf_ranges, simulate

mujoco = pytest.importorskip("mujoco")

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
        told = ", ".join(f"{key} = {value}" for key, value in numbers.items())
        lines += [
            "[[effects]]",
            f'effect = "{name}"',
            f'site = "{site}"',
            f'kind = "{kind}"',
            f"values = {{ {told} }}",
        ]
    (folder / "corrected.toml").write_text("\n".join(lines) + "\n")
    return load_model(folder / "corrected.toml")


def both(model, xml):
    """Return what labrun and MuJoCo alone say of a swing, at 100 Hz."""
    time_s = np.arange(0.0, 3.0, 0.01)
    goal = 0.7 * np.sin(2 * np.pi * 0.7 * time_s)
    own = simulate(model, time_s, goal[:, None], initial_state=[0.0, 0.0]).outputs[:, 0]
    native = mujoco.MjModel.from_xml_string(xml)
    data, alone = mujoco.MjData(native), []
    for told in goal:
        alone.append(float(data.qpos[0]))
        data.ctrl[0] = told
        for _ in range(round(0.01 / native.opt.timestep)):
            mujoco.mj_step(native, data)
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
    assert "body_mass[1] 0.3 became 0.33" in exported.written


def test_what_has_no_word_in_mjcf_is_listed_with_its_law(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "corrected.toml").write_text(
        'base = "arm.xml"\n[[effects]]\neffect = "cubic-stiffness"\nsite = "shoulder"\nkind = "joint"\n'
        'values = { coefficient = 2.0 }\n[[effects]]\neffect = "delay"\nsite = "shoulder"\nkind = "output"\n'
        "values = { delay = 0.01 }\n"
    )
    law, sensor = mjcf_of(load_model(tmp_path / "corrected.toml")).left
    assert "cubic-stiffness at shoulder has no word in MJCF: F = -coefficient*q^3 with coefficient = 2" in law
    assert "belongs to the sensor" in sensor


def test_intervals_are_told_as_the_numbers_of_mjcf(tmp_path):
    model = corrected(tmp_path, [])
    found = mjcf_ranges(model, {"servo_kp": (8.0, 7.5, 8.5), "upper_mass": (0.3, 0.29, 0.31)})
    assert [(one.array, one.element, one.joint, one.low, one.high) for one in found] == [
        ("actuator_gainprm", "servo", "shoulder", 7.5, 8.5), ("body_mass", "upper", "", 0.29, 0.31),
    ]  # fmt: skip


def test_a_model_of_equations_has_no_mjcf(tmp_path):
    (tmp_path / "a.toml").write_text(
        'name = "a"\nstates = ["x"]\n[equations]\nx = "-x"\n[outputs]\nx = "x"\n'
    )
    with pytest.raises(ModelError, match="no model in MuJoCo"):
        mjcf_of(load_model(tmp_path / "a.toml"))
