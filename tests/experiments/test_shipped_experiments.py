"""The experiments that ship: they load, and their numbers are those of the source."""

import math
import warnings
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.rigs.hinge.dimensions import damping, stiffness

from labrun.devices import Limits
from labrun.experiment import find_model_file, load_experiment, loads_experiment, shipped_experiments
from labrun.gaits import make_gait
from labrun.search import conditions
from labrun.toml import split_unit

IN_THE_FIELD = {"field-turn": "turn-torque", "field-forward": "tail-sweep", "field-swim": "forward-pectoral"}
"""Runs in the field, and the search whose leaders they take there."""
NAMES = sorted(path.stem for path in shipped_experiments().glob("*.toml"))


@cache
def shipped(name):
    return load_experiment(shipped_experiments() / f"{name}.toml").experiment


def limits(name, device):
    return Limits.model_validate(shipped(name).rig.devices[device].settings["limits"])


def worst_deg(motion):
    return float(np.degrees(np.abs(motion.angle_rad)).max())


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_file_loads_and_its_resolved_text_is_equal(name):
    loaded = load_experiment(shipped_experiments() / f"{name}.toml")
    assert loads_experiment(loaded.resolved_toml, name).experiment == loaded.experiment


def test_the_fin_sweep_has_the_sources_2292_trials():
    points = conditions(shipped("fin-params"))
    repeats = shipped("fin-params").trial.repeats
    assert (len(points), repeats.min, repeats.max) == (764, 3, 3)
    assert len(points) * repeats.max == 2292
    text = (shipped_experiments() / "fin-params.toml").read_text()
    assert "764 conditions" in text
    assert "2292 trials" in text


def test_the_fin_sweep_stays_within_the_sources_ranges_and_holds_its_best_point():
    points = conditions(shipped("fin-params"))
    assert {"b": 0.0, "a": 60.0, "f": 1.4} in points
    for point in points:
        assert abs(point["b"]) <= 20
        assert 0 < point["a"] <= 60 - abs(point["b"])
        assert 0 < point["f"] <= 84 / point["a"] * (1 + 1e-12)
    assert shipped("fin-params").trial.cycles == 5
    assert shipped("fin-params").trial.reference.condition == {"b": 0, "a": 60, "f": 1.4}


def test_every_condition_of_the_fin_sweep_is_within_the_servos_limits():
    gait, bounds = make_gait(shipped("fin-params").gait), limits("fin-params", "tail")
    for point in conditions(shipped("fin-params")):
        motion = gait.trajectory(point, duration_s=2 / point["f"], rate_hz=100)
        assert not list(bounds.trajectory_excess(motion)), point


def test_the_modulated_gait_is_equation_5_3_with_the_magnitude_of_b():
    experiment = shipped("fin-modulation")
    (point,) = conditions(experiment)
    assert experiment.trial.duration_s == 500
    motion = make_gait(experiment.gait).trajectory(point, duration_s=500, rate_hz=100)
    t = motion.time_s
    b = 20 * np.sin(2 * np.pi * 0.002 * t)
    a = 20 + np.abs((40 - np.abs(b)) * np.sin(2 * np.pi * 0.004 * t))
    np.testing.assert_allclose(
        np.degrees(motion.angle_rad[:, 0]), b + a * np.sin(2 * np.pi * 1.4 * t), atol=1e-9
    )
    assert not list(limits("fin-modulation", "tail").trajectory_excess(motion))


@given(st.floats(0, 2000))
def test_equation_5_3_never_leaves_60_degrees(t):
    b = 20 * math.sin(2 * math.pi * 0.002 * t)
    motion = make_gait(shipped("fin-modulation").gait).trajectory(
        {"offset_range": 20}, duration_s=t + 1, rate_hz=0.5
    )
    assert worst_deg(motion) <= 60 + 1e-9
    amplitude = 20 + abs((40 - abs(b)) * math.sin(2 * math.pi * 0.004 * t))
    assert 20 <= amplitude <= 60 - abs(b) + 1e-9


def test_the_step_tests_go_from_rest_to_40_degrees_and_from_0_to_minus_20():
    experiment = shipped("fin-step")
    gait, bounds = make_gait(experiment.gait), limits("fin-step", "tail")
    magnitude, angle = (
        gait.trajectory(point, duration_s=experiment.trial.duration_s, rate_hz=100)
        for point in conditions(experiment)
    )
    degrees = np.degrees(magnitude.angle_rad[:, 0])
    assert np.abs(degrees[magnitude.time_s < 10]).max() == 0
    assert np.abs(degrees[magnitude.time_s > 11]).max() == pytest.approx(40, abs=0.1)
    degrees, t = np.degrees(angle.angle_rad[:, 0]), angle.time_s
    cycle = 5 / 1.4
    assert degrees[(t >= 10 - cycle) & (t < 10)].mean() == pytest.approx(0, abs=0.5)
    assert degrees[(t >= 20) & (t < 20 + cycle)].mean() == pytest.approx(-20, abs=0.5)
    for motion in (magnitude, angle):
        assert not list(bounds.trajectory_excess(motion))
        assert motion.period_s == pytest.approx(1 / 1.4)


@pytest.mark.parametrize("name", ["turn-torque", "turn-torque-current"])
def test_the_turning_search_is_that_of_table_6_1(name):
    experiment = shipped(name)
    search = experiment.cmaes
    assert set(search.variables) == {"alpha_1", "alpha_2", "beta_1", "beta_2", "f", "phi"}
    assert (search.population, search.parents, search.stop.iterations) == (60, 30, 1000)
    assert search.stop.stagnation is not None
    assert (experiment.trial.repeats.min, experiment.trial.repeats.max) == (3, 3)
    assert experiment.goal == ("turning", "maximise")
    assert experiment.objectives["turning"].channel == "wrench.torque_z"


def test_still_water_has_no_carriage_and_the_current_is_a_tenth_of_a_metre_per_second():
    assert shipped("turn-torque").trial.carriage is None
    assert "arm" in shipped("turn-torque").rig.devices
    move = shipped("turn-torque-current").trial.carriage
    assert move.speed_m_s.given == 0.1
    assert shipped("turn-torque-current").trial.cycles == "fit"
    slowest = shipped("turn-torque-current").cmaes.variables["f"].start
    travel_s = (move.to_m - move.from_m) / move.speed_m_s.given
    assert travel_s * slowest >= shipped("turn-torque-current").trial.discard_cycles + 1


@given(
    st.floats(0, 30),
    st.floats(0, 30),
    st.floats(-30, 30),
    st.floats(-30, 30),
    st.floats(0.4, 1.4),
    st.floats(-180, 180),
)
def test_the_left_fin_does_the_opposite_of_the_right_by_equation_6_2(
    alpha_1, alpha_2, beta_1, beta_2, f, phi
):
    point = {"alpha_1": alpha_1, "alpha_2": alpha_2, "beta_1": beta_1, "beta_2": beta_2, "f": f, "phi": phi}
    motion = make_gait(shipped("turn-torque").gait).trajectory(point, duration_s=2, rate_hz=50)
    t = motion.time_s
    right_1 = beta_1 + alpha_1 * np.sin(2 * np.pi * f * t)
    right_2 = beta_2 + alpha_2 * np.sin(2 * np.pi * f * t + np.radians(phi))
    expected = np.column_stack([right_1, right_2, -right_1, -right_2])
    np.testing.assert_allclose(np.degrees(motion.angle_rad), expected, atol=1e-9)
    assert motion.joints == ("right_1", "right_2", "left_1", "left_2")


def test_the_hinge_is_released_from_several_angles_five_times_each_at_360_frames_a_second():
    experiment = shipped("hinge")
    angles = [point["release"] for point in conditions(experiment)]
    assert len(set(angles)) == len(angles) >= 3
    assert (experiment.trial.repeats.min, experiment.trial.repeats.max) == (5, 5)
    assert experiment.rig.devices["cameras"].settings["rate_hz"] == 360
    assert experiment.gait.plugin == "release"
    assert experiment.fit.method == "hinge"
    assert (
        find_model_file(experiment.fit.model, shipped_experiments() / "hinge.toml", shipped_experiments())
        is not None
    )


@pytest.mark.parametrize(
    ("name", "size", "count", "nominal"),
    [
        ("hinge-width", "width_mm", 5, {"length_mm": 1.75, "area_cm2": 43}),
        ("hinge-length", "length_mm", 5, {"width_mm": 50, "area_cm2": 43}),
        ("hinge-area", "area_cm2", 7, {"width_mm": 50, "length_mm": 1.75}),
    ],
)
def test_specimens_are_the_sources_number_released_five_times_and_never_changed_twice(
    name, size, count, nominal
):
    experiment = shipped(name)
    points = conditions(experiment)
    sizes = [point[size] for point in points]
    assert len(set(sizes)) == count
    assert all(sizes.count(other) == 5 for other in sizes)
    assert all({key: point[key] for key in nominal} == nominal for point in points)
    changes = sum(first != other for first, other in pairwise(sizes))
    assert experiment.sweep.order == "as-listed"
    assert (experiment.trial.repeats.min, experiment.trial.repeats.max) == (1, 1)
    assert changes == count - 1
    mounted = list(dict.fromkeys(sizes))
    assert mounted not in (sorted(mounted), sorted(mounted, reverse=True))
    assert size in experiment.rig.devices["hinge"].settings["instruction"]
    assert experiment.rig.devices["cameras"].settings["rate_hz"] == 360
    assert experiment.fit.method == "hinge-maps"
    file = shipped_experiments() / f"{name}.toml"
    assert find_model_file(experiment.fit.model, file, shipped_experiments()) is not None


@pytest.mark.parametrize("name", ["hinge-width", "hinge-length", "hinge-area"])
def test_every_specimen_is_one_at_which_the_comprehensive_maps_hold(name):
    for point in conditions(shipped(name)):
        width_m, length_m, area_m2 = (
            point["width_mm"] * 1e-3,
            point["length_mm"] * 1e-3,
            point["area_cm2"] * 1e-4,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert damping(area_m2, width_m, length_m) > 0
        assert stiffness(width_m, length_m) > 0


@pytest.mark.parametrize("name", [name for name in NAMES if name not in IN_THE_FIELD])
def test_every_file_has_a_title_and_states_the_units_of_its_conditions(name):
    experiment = shipped(name)
    assert experiment.title
    numbers = {key for key, value in conditions(experiment)[0].items() if not isinstance(value, str)}
    named = {
        block
        for loop in (experiment.track.loops.values() if experiment.track else ())
        for block in listed(loop.drives)
    }
    by_ending = {name for name in numbers if split_unit(name)[1] is not None}  # `frequency_hz` states its own
    assert numbers - by_ending <= set(experiment.units) <= numbers | named | set(experiment.over)


@pytest.mark.parametrize(("name", "laboratory"), IN_THE_FIELD.items())
def test_the_conditions_of_the_field_are_those_of_the_laboratory(name, laboratory):
    """They are known only when the laboratory's search has run, and have its units."""
    theirs, field = shipped(laboratory), shipped(name)
    assert field.run.conditions.experiments == [laboratory]
    assert all(field.units[key] == unit for key, unit in theirs.units.items() if key in field.units)
    assert set(field.units) <= set(theirs.units)


def listed(block):
    return [block] if isinstance(block, str) else block
