"""What a cause stands in for explains more than it does; beside a right one no law does, whatever explains its rest."""

from dataclasses import replace

import numpy as np
import pytest
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.other_laws import better_alone
from scipy.integrate import solve_ivp

from labrun.effects import load_effect
from labrun.gap import criteria
from labrun.gap.averaging import averaged
from labrun.gap.candidates import site_scales
from labrun.gap.recalibration import recalibrate
from labrun.gap.screening import refit

from .benches import TRUE, pendulum, recorded

RIDER = 0.15 * TRUE["inertia"], 2 * np.pi * 3.5, 0.02
"""Inertia, angular frequency and damping ratio of what rides on the hinge: twice to six times as fast as it swings."""


def with_a_rider(data):
    """Return the recording with what the pendulum does that carries a mass on a spring."""
    mass, natural, ratio = RIDER

    def angle_of(time_s, torque):
        def slope(t, x):
            angle, rate, own, own_rate = x
            pull = natural**2 * (own - angle) + 2 * ratio * natural * (own_rate - rate)
            force = float(np.interp(t, time_s, torque)) + mass * pull - TRUE["stiffness"] * angle
            force -= TRUE["damping"] * rate + TRUE["gravity"] * np.sin(angle)
            return [rate, force / TRUE["inertia"], own_rate, -pull]

        course = solve_ivp(
            slope, (time_s[0], time_s[-1]), [0.0] * 4, t_eval=time_s, rtol=1e-7, atol=1e-9, max_step=0.01
        )
        return course.y[0]

    rng = np.random.default_rng(1)
    angles = {one.condition["frequency_hz"]: angle_of(one.time_s, one.inputs[:, 0]) for one in data.trials}
    trials = []
    for one in data.trials:
        angle = angles[one.condition["frequency_hz"]]
        trials.append(replace(one, outputs=(angle + 1e-3 * rng.standard_normal(len(angle)))[:, None]))
    return replace(data, trials=tuple(trials))


def better_than(data, cause, kind="joint", site="hinge"):
    """Return which law explains a recording better than a cause, once both are fitted to it."""
    model = pendulum()
    found = recalibrate(model, averaged(data, model), np.random.default_rng(0), lambda _: None)
    scale = site_scales(found.problem, found.z)[kind, site]
    attached = load_effect(cause, kind).attach(site, scale)
    problem = found.problem.with_effects([attached], [scale])
    sizes = [one.starts[0] for one in attached.effect.parameters if not one.held]
    end = refit(problem, np.insert(found.z, found.problem.size, sizes))
    chance = NoiseThreshold(gain=20.0, dispersion=1.0)
    return better_alone((problem, end), (found.problem, found.z), found.noise, chance, floor=0.1)


def test_a_mass_on_a_spring_explains_more_than_the_inertia_that_stood_in_for_it():
    data = with_a_rider(recorded(noise=1e-3))
    assert better_than(data, "added-inertia") == "a mass on a spring that rides at hinge"


def test_a_damper_that_warms_explains_more_than_the_damping_that_stood_in_for_it():
    data = recorded(lambda t, q, v: -2e-3 * v * (1.0 - np.exp(-t / 3.0)), noise=1e-3)
    assert better_than(data, "viscous-damping") == "a law of rate and time at hinge"


@pytest.mark.parametrize(
    "beside",
    [
        pytest.param(lambda t, q, v: -0.01 * q**3, id="a law of position"),
        pytest.param(lambda t, q, v: 1e-3 * t**2, id="a force of time", marks=pytest.mark.slow),
        pytest.param(lambda t, q, v: -2e-4 * t * v, id="a damper that changes", marks=pytest.mark.slow),
    ],
)
def test_no_law_explains_as_much_as_a_right_cause_whatever_explains_what_it_leaves(beside):
    friction = 5e-3
    data = recorded(lambda t, q, v: -friction * float(np.tanh(v / 0.02)) + beside(t, q, v), noise=1e-3)
    assert better_than(data, "coulomb-friction") == ""


def test_where_the_rest_is_a_law_of_the_causes_own_arguments_its_form_is_another_one_and_it_is_no_stand_in():
    data = recorded(lambda t, q, v: -2e-5 * v**3, noise=1e-3)
    assert better_than(data, "quadratic-drag") == ""


def test_no_law_is_better_than_a_cause_by_what_chance_may_explain():
    assert better_than(recorded(noise=1e-3), "viscous-damping") == ""


def test_beside_a_bias_that_settles_a_law_of_time_is_no_other_law():
    data = recorded(noise=1e-3)
    settling = [
        replace(one, outputs=one.outputs + 0.05 * (1.0 - 0.2 * (1.0 - np.exp(-one.time_s / 2.0)))[:, None])
        for one in data.trials
    ]
    assert better_than(replace(data, trials=tuple(settling)), "bias", "output", "angle") == ""


def test_a_law_that_is_seen_in_the_conditions_that_leave_most_is_asked_of_all():
    conditions = [(amplitude, frequency) for amplitude in (0.02, 0.03, 0.04) for frequency in (0.4, 0.6, 0.8)]
    assert len(conditions) > criteria.MOST_CONDITIONS
    data = recorded(
        lambda t, q, v: -2e-3 * v * (1.0 - np.exp(-t / 3.0)), noise=1e-3, repeats=2, conditions=conditions
    )
    assert better_than(data, "viscous-damping") == "a law of rate and time at hinge"
