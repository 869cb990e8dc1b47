"""The fish let loose: Kirchhoff's equations, gliding, mirrored turns, and a tail that slows them."""

import numpy as np
import pytest
from labrun_plugins.rigs.fish import free_scene
from labrun_plugins.rigs.fish.free_scene import FireFree
from labrun_plugins.simulated.bench import model_beside
from scipy.integrate import solve_ivp

from labrun.devices import Trajectory
from labrun.errors import SpecError
from labrun.models import Stepper

SEEN = ["x", "y", "heading", "ahead", "aside", "turning"]
GAIT = (40.0, 35.0, 20.0, -24.0, 1.4, 67.0)
WINNER = (38.39, 38.68, -20.0, 18.57, 1.494, -65.0)
"""What turn-torque finds."""
FREE = {"hull_drag": 0.0, "drag_aside": 0.0, "yaw_drag": 0.0}


def _glide(state, parameters, duration_s, step_s=0.005):
    model = model_beside(free_scene.__file__, "free.toml")
    stepper = Stepper(model, parameters, step_s=step_s)
    whole = np.zeros(len(model.states))
    whole[:6] = state
    stepper.state = whole
    return stepper.advance(np.zeros((round(duration_s / step_s) + 1, 7)))


def _swim(*, side=-1.0, gait=GAIT, tail_deg=0.0, duration_s=16.0, **settings):
    fish = FireFree({"noise": 0} | settings, np.random.default_rng(0))
    fish.observe(SEEN, np.array([0.0]))
    a1, a2, b1, b2, frequency_hz, phase_deg = gait
    time_s = np.linspace(0.0, duration_s, round(100 * duration_s) + 1)
    turn = 2 * np.pi * frequency_hz * time_s
    first, second = b1 + a1 * np.sin(turn), b2 + a2 * np.sin(turn + np.radians(phase_deg))
    angles = (first, second, side * first, side * second, tail_deg * np.sin(2 * np.pi * 1.4 * time_s))
    for joint, angle in zip(fish.joints, angles, strict=True):
        fish.drive(joint, Trajectory((joint,), time_s, np.radians(angle)[:, None]), 0.5)
    return time_s, fish.observe(SEEN, 0.5 + time_s)


def _rate_deg_s(time_s, seen):
    half = len(time_s) // 2
    return np.degrees(seen[-1, 2] - seen[half, 2]) / (time_s[-1] - time_s[half])


def test_without_drag_a_gliding_body_keeps_its_kinetic_energy():
    seen = _glide([0, 0, 0, 0.3, 0.1, 0.5], FREE, 10.0)
    energy = 0.5 * (2.0 * seen[:, 3] ** 2 + 3.0 * seen[:, 4] ** 2 + 0.05 * seen[:, 5] ** 2)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)


def test_without_drag_its_impulse_keeps_size_and_direction_in_the_world():
    seen = _glide([0, 0, 0.4, 0.3, 0.1, 0.5], FREE, 10.0)
    cosine, sine = np.cos(seen[:, 2]), np.sin(seen[:, 2])
    ahead, aside = 2.0 * seen[:, 3], 3.0 * seen[:, 4]
    np.testing.assert_allclose(cosine * ahead - sine * aside, (cosine * ahead - sine * aside)[0], atol=1e-6)
    np.testing.assert_allclose(sine * ahead + cosine * aside, (sine * ahead + cosine * aside)[0], atol=1e-6)


def test_a_straight_glide_slows_down_as_quadratic_drag_has_it():
    seen = _glide([0, 0, 0, 0.4, 0, 0], {"hull_drag": 0.8}, 5.0)
    time_s = 0.005 * np.arange(1, len(seen) + 1)
    np.testing.assert_allclose(seen[:, 3], 0.4 / (1 + 0.8 * 0.4 * time_s / 2.0), rtol=1e-6)
    np.testing.assert_allclose(seen[:, 0], 2.0 / 0.8 * np.log1p(0.8 * 0.4 * time_s / 2.0), rtol=1e-6)


def test_a_glide_with_all_drags_is_that_of_an_independent_integrator():
    m_a, m_s, inertia, c_a, c_s, c_r = 2.0, 3.0, 0.05, 0.8, 40.0, 0.006

    def rates(_, s):
        heading, u, v, r = s[2:]
        return [
            np.cos(heading) * u - np.sin(heading) * v,
            np.sin(heading) * u + np.cos(heading) * v,
            r,
            (m_s * v * r - c_a * u * abs(u)) / m_a,
            (-m_a * u * r - c_s * v * abs(v)) / m_s,
            ((m_a - m_s) * u * v - c_r * r * abs(r)) / inertia,
        ]

    start = [0, 0, 0, 0.4, 0.1, 0.8]
    exact = solve_ivp(rates, (0, 4), start, rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(_glide(start, {}, 4.0)[-1], exact, atol=1e-5)


def test_a_mirrored_gait_turns_it_as_fast_the_other_way():
    _, seen = _swim()
    _, mirrored = _swim(gait=(-GAIT[0], -GAIT[1], -GAIT[2], -GAIT[3], *GAIT[4:]))
    np.testing.assert_allclose(mirrored[:, [1, 2]], -seen[:, [1, 2]], atol=1e-7)
    np.testing.assert_allclose(mirrored[:, 0], seen[:, 0], atol=1e-7)


def test_a_gait_that_wins_on_the_arm_turns_it_at_about_the_measured_rates():
    assert abs(_rate_deg_s(*_swim(gait=WINNER, caudal="off"))) == pytest.approx(30.25, rel=0.1)
    assert abs(_rate_deg_s(*_swim(gait=WINNER, caudal="on", water="pool"))) == pytest.approx(15.68, rel=0.1)


def test_with_its_tail_it_swims_straight_ahead_and_faster_than_on_the_arm():
    time_s, seen = _swim(side=1.0, gait=(0, 0, -25.6, 60, 1.0, 0), tail_deg=60.0, duration_s=20.0)
    speed_m_s = (seen[-1, 0] - seen[1000, 0]) / (time_s[-1] - time_s[1000])
    assert speed_m_s > 0.2
    assert abs(seen[-1, 1]) < 0.05 * seen[-1, 0]


def test_the_one_who_puts_it_back_finds_it_at_rest_where_it_began():
    fish = FireFree({"noise": 0}, np.random.default_rng(0))
    time_s = np.linspace(0.0, 3.0, 301)
    angle = np.radians(60 * np.sin(2 * np.pi * 1.4 * time_s))
    fish.drive("tail", Trajectory(("tail",), time_s, angle[:, None]), 0.0)
    assert abs(fish.observe(["x"], time_s)[-1, 0]) > 0.05
    fish.arrange({"caudal": "off", "water": "pool"})
    np.testing.assert_allclose(fish.observe(SEEN, np.array([3.03]))[0, :3], 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("condition", "message"),
    [({"water": "sea"}, "no water 'sea'"), ({"caudal": "half"}, "no caudal 'half'")],
)
def test_what_the_fish_has_not_is_told(condition, message):
    fish = FireFree({}, np.random.default_rng(0))
    with pytest.raises(SpecError, match=message):
        fish.arrange(condition)


def test_a_setting_it_does_not_know_is_told():
    with pytest.raises(SpecError, match=r"rig\.scene\.caudal"):
        FireFree({"caudal": "maybe"}, np.random.default_rng(0))
