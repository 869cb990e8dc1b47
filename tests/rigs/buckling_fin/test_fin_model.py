"""The fin model: conservation, an independent integrator, the published table, and where its hinge begins to buckle."""

import math

import numpy as np
import pytest
from labrun_plugins.rigs.buckling_fin.model import fin_model
from scipy.integrate import solve_ivp

from labrun.models import simulate

NOTHING_HOLDS = {"density": 0.0, "body_area": 0.0, "motor_spacing": 0.06, "link": 0.1, "arm": 0.07}
FREE = fin_model("free", fins=2, free=("x", "y", "yaw"))
WING = fin_model("wing", fins=1)


def column(model, outputs, name):
    return outputs[:, [output.name for output in model.outputs].index(name)]


def strokes(time_s, amplitude_deg, frequency_hz, phase=0.0):
    return math.radians(amplitude_deg) * np.sin(2 * math.pi * frequency_hz * time_s + phase)


def plates(model, outputs, values):
    """Return where both plates are, from the angles that the model gives, shape (2, samples, 2)."""
    x, y, yaw = (column(model, outputs, name) for name in ("x", "y", "yaw"))
    results = []
    for number, side in ((1, 1.0), (2, -1.0)):
        theta = column(model, outputs, f"base_{number}")
        phi = theta + column(model, outputs, f"bend_{number}")
        ahead = values["link"] * np.sin(theta) + values["arm"] * np.sin(phi)
        aside = side * (
            0.5 * values["motor_spacing"] + values["link"] * np.cos(theta) + values["arm"] * np.cos(phi)
        )
        results.append(
            np.column_stack([
                x + np.cos(yaw) * ahead - np.sin(yaw) * aside,
                y + np.sin(yaw) * ahead + np.cos(yaw) * aside,
            ])
        )  # fmt: skip
    return np.array(results)


def test_without_water_and_mount_the_centre_of_mass_stays_where_it_is_whatever_the_servos_do():
    time_s = np.arange(0.0, 2.0, 0.002)
    message = np.column_stack([strokes(time_s, 50, 1.0), strokes(time_s, 30, 1.7, 1.0)])
    outputs = simulate(FREE, time_s, message, parameters=NOTHING_HOLDS, substeps=4).outputs
    mass = 0.0245
    body = np.column_stack([column(FREE, outputs, "x"), column(FREE, outputs, "y")])
    centre = (body + mass * plates(FREE, outputs, NOTHING_HOLDS).sum(axis=0)) / (1.0 + 2 * mass)
    # the second servo begins with a jerk of its own, from rest
    assert np.abs(column(FREE, outputs, "yaw")).max() > 0.01
    assert np.abs(centre - centre[0]).max() < 1e-7


def test_the_servos_work_is_the_gain_in_energy_and_what_the_hinges_take():
    time_s = np.arange(0.0, 1.0, 0.0005)
    message = np.column_stack([strokes(time_s, 40, 1.5), strokes(time_s, 40, 1.5)])
    values = NOTHING_HOLDS | {"equal_limit": 10.0, "opposite_limit": 10.0, "body_mass": 0.3}
    outputs = simulate(FREE, time_s, message, parameters=values, substeps=2).outputs
    mass, k, c = 0.0245, 0.506, 0.0065
    rates = {name: np.gradient(column(FREE, outputs, name), time_s) for name in ("x", "y", "yaw", "bend_1")}
    speeds = np.gradient(plates(FREE, outputs, values), time_s, axis=1)
    kinetic = 0.5 * mass * np.square(speeds).sum(axis=(0, 2))
    kinetic += 0.15 * (rates["x"] ** 2 + rates["y"] ** 2) + 0.5 * 5e-3 * rates["yaw"] ** 2
    spring = sum(0.5 * k * column(FREE, outputs, f"bend_{fin}") ** 2 for fin in (1, 2))
    power = sum(
        column(FREE, outputs, f"servo_{fin}") * column(FREE, outputs, f"base_rate_{fin}") for fin in (1, 2)
    )
    lost = 2 * c * rates["bend_1"] ** 2  # both fins do the same
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power - lost)[1:] + 0.5 * (power - lost)[:-1])]) * 0.0005
    gained = kinetic + spring
    assert gained.max() > 0.005
    assert np.abs(work - gained)[10:-10].max() < 0.01 * gained.max()


def test_a_wing_swings_as_another_formulation_and_another_integrator_say():
    """The fin held by its base as one Lagrange equation in the plate's angle, written down once more."""
    d1, r, m, k, low, soft, c, area = 0.1232, 0.11245, 0.0245, 0.506, 0.1063, 0.0152, 0.0065, 0.08 * 0.0669
    w = 2 * math.pi * 6.0

    def rates(t, state):
        theta, theta_rate, phi, phi_rate = state
        theta_acceleration = w * w * (math.radians(66) * math.sin(2.5 * t) - theta) - 1.6 * w * theta_rate
        bend = phi - theta
        spring = k * bend if bend > -low / k else -low + soft * (bend + low / k)
        lag = phi - theta  # angle between link and plate
        normal = d1 * theta_rate * math.cos(lag) + r * phi_rate
        along = d1 * theta_rate * math.sin(lag)
        force = -1000 * area * math.hypot(normal, along) * normal
        moment = force * r - spring - c * (phi_rate - theta_rate)
        inertial = m * d1 * r * (theta_acceleration * math.cos(lag) + theta_rate**2 * math.sin(lag))
        return theta_rate, theta_acceleration, phi_rate, (moment - inertial) / (m * r * r)

    time_s = np.arange(0.0, 5.0, 0.01)
    theirs = solve_ivp(rates, (0, 5), [0.0] * 4, t_eval=time_s[:-1], rtol=1e-9, atol=1e-10, max_step=0.01).y
    fine_s = np.arange(0.0, 5.0, 0.001)
    message = math.radians(66) * np.sin(2.5 * fine_s)
    ours = simulate(WING, fine_s, np.column_stack([message, 0 * message]), substeps=2).outputs[::10][:-1]
    bend = column(WING, ours, "bend_1")
    assert bend.min() < -low / k, "it buckles"
    assert np.abs(bend - (theirs[2] - theirs[0])).max() < 2e-4


@pytest.mark.parametrize(
    ("frequency_hz", "least", "most", "buckles"),
    [
        (0.1, -0.04, 0.04, False),
        (0.2, -0.14, 0.14, False),
        (0.3, -0.23, 0.30, True),
        (0.4, -0.24, 0.46, True),
    ],
)
def test_the_wing_in_water_makes_the_simulated_extremes_of_table_7_2(frequency_hz, least, most, buckles):
    time_s = np.arange(0.0, 3 / frequency_hz, 0.004)
    message = strokes(time_s, 66, frequency_hz)
    outputs = simulate(WING, time_s, np.column_stack([message, 0 * message]), substeps=4).outputs
    settled = outputs[time_s > 1 / frequency_hz]
    # the frame feels what the servo turns with, the other way round
    torque = -column(WING, settled, "servo_1")
    assert torque.min() == pytest.approx(least, abs=0.02)
    assert torque.max() == pytest.approx(most, abs=0.02)
    assert (column(WING, settled, "bend_1").min() < -0.1063 / 0.506) == buckles


def test_the_mount_of_a_wing_without_distance_to_its_axis_feels_what_its_servo_turns_with():
    time_s = np.arange(0.0, 5.0, 0.005)
    message = strokes(time_s, 66, 0.3)
    outputs = simulate(
        WING, time_s, np.column_stack([message, 0 * message]), substeps=4, parameters={"motor_spacing": 0.0}
    ).outputs
    # yaw is positive to the left, a fin's angle to the front: the left one's is the other way round
    assert column(WING, outputs, "torque_z") == pytest.approx(column(WING, outputs, "servo_1"), abs=1e-12)
