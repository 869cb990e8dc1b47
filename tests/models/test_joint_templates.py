"""The models that ship as templates of joints: against closed forms."""

import numpy as np
import pytest

from labrun.effects import AttachedEffect, load_effect
from labrun.models import load_model, simulate


def course(name, drive, duration_s, begin, **values):
    """Return angle and rate at the end of a constant drive, and the model's parameters."""
    model = load_model(name)
    time_s = np.linspace(0.0, duration_s, 2001)
    inputs = np.full((len(time_s), 1), drive)
    made = simulate(model, time_s, inputs, parameters=values, initial_state=begin)
    return (
        made.states[:, 0],
        made.states[:, 1],
        {parameter.name: parameter.value for parameter in model.parameters} | values,
    )


def test_a_motor_runs_up_to_the_speed_at_which_its_back_emf_and_damping_take_the_voltage():
    _, rate, p = course("dc-motor", 6.0, 3.0, (0.0, 0.0), moment=0.0)
    constant, resistance = p["gear"] * p["torque_constant"], p["resistance"]
    brake = constant**2 / resistance + p["damping"]
    end, time_constant = constant * 6.0 / resistance / brake, (p["arm"] + p["gear"] ** 2 * p["rotor"]) / brake
    time_s = np.linspace(0.0, 3.0, 2001)
    assert rate == pytest.approx(end * (1.0 - np.exp(-time_s / time_constant)), rel=1e-6, abs=1e-9)


def test_a_motor_that_is_held_by_its_load_puts_out_the_torque_of_its_stalled_current():
    p = {parameter.name: parameter.value for parameter in load_model("dc-motor").parameters}
    volts = 1.0
    held = np.arcsin(p["gear"] * p["torque_constant"] * volts / p["resistance"] / (9.81 * p["moment"] * 4.0))
    angle, rate, _ = course("dc-motor", volts, 0.5, (held, 0.0), moment=4.0 * p["moment"])
    assert np.abs(angle - held).max() < 1e-9
    assert np.abs(rate).max() < 1e-9


def test_a_servo_swings_about_the_goal_that_the_weight_leaves_it():
    p = {parameter.name: parameter.value for parameter in load_model("position-servo").parameters}
    goal = 0.4
    angle, rate, _ = course("position-servo", goal, 4.0, (goal, 0.0))
    torque = p["gain"] * (goal - angle[-1])
    assert torque == pytest.approx(9.81 * p["moment"] * np.sin(angle[-1]), rel=1e-6)
    assert abs(rate[-1]) < 1e-6


def test_a_servo_gives_no_more_than_its_strongest_torque():
    angle, _, p = course("position-servo", 2.0, 0.02, (0.0, 0.0), moment=0.0)
    time_s = np.linspace(0.0, 0.02, 2001)
    assert angle == pytest.approx(0.5 * p["strongest"] / p["inertia"] * time_s**2, rel=1e-6, abs=1e-12)


def test_a_free_joint_keeps_its_energy():
    angle, rate, p = course("torque-joint", 0.0, 5.0, (1.0, 0.0), damping=0.0)
    energy = 0.5 * p["inertia"] * rate**2 - 9.81 * p["moment"] * np.cos(angle)
    assert np.ptp(energy) < 1e-6 * 9.81 * p["moment"]


@pytest.mark.parametrize(
    ("name", "drive", "as_parameters"),
    [
        ("position-servo", 0.3, {"gain": 8.8, "rate_gain": 0.22, "strongest": 1.65}),
        ("dc-motor", 6.0, {"resistance": 4.0 / 1.1}),
    ],
)
def test_a_drive_that_is_too_strong_is_one_of_other_constants(name, drive, as_parameters):
    model = load_model(name)
    stronger = AttachedEffect(load_effect("drive-gain"), "joint", (0.1,))
    time_s = np.linspace(0.0, 1.0, 1001)
    inputs = np.full((len(time_s), 1), drive)
    with_effect = simulate(model, time_s, inputs, initial_state=(0.0, 0.0), effects=[stronger])
    by_hand = simulate(model, time_s, inputs, initial_state=(0.0, 0.0), parameters=as_parameters)
    assert np.ptp(by_hand.outputs) > 0.1
    assert with_effect.outputs == pytest.approx(by_hand.outputs, abs=1e-6)
