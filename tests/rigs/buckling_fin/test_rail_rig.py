"""The swimmer on its rail: it swims, sticks, is pulled back, is stopped where the tank ends; one limb turns it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from labrun_plugins.rigs.buckling_fin.rail_rig import RailRig
from labrun_plugins.rigs.buckling_fin.swimmers import free_swimmer, swimmer_on_rail

from labrun.app.question import ask
from labrun.app.run import run
from labrun.devices import Trajectory
from labrun.effects import Scale, load_effect
from labrun.experiment import load_experiment, shipped_experiments
from labrun.models import simulate
from labrun.store import open_run

DESIGN = {
    "motor_spacing": 0.04, "link": 0.1121, "arm": 0.0873, "plate_area": 0.009136, "plate_mass": 0.01581,
    "added_mass": 0.0, "body_area": 0.004,
}  # fmt: skip
STROKE_RAD, BACK_RAD, HZ = np.radians(42), np.radians(-55), 0.82


def rowed(start_s=3.0, stroke_rad=STROKE_RAD, back_rad=BACK_RAD, hz=HZ, **settings):
    rig = RailRig({"design": DESIGN, **settings}, np.random.default_rng(1))
    rig.observe(("position",), np.zeros(1))
    slowly = np.linspace(0, 1, 41)
    time_s = np.linspace(0, 5, 501)
    gait = back_rad + stroke_rad * np.sin(2 * np.pi * hz * time_s)
    for joint in rig.joints:
        rig.drive(joint, Trajectory((joint,), 2 * slowly, (slowly * gait[0])[:, None]), 0.5)
        rig.drive(joint, Trajectory((joint,), time_s, gait[:, None]), start_s)
    return rig


def seen(rig, signal, *times_s):
    return rig.observe((signal,), np.array(times_s))[:, 0]


def test_rowing_pushes_the_held_carriage_by_5_to_9_newtons_and_pulls_it_by_less_than_2():
    force = seen(rowed(rail="locked"), "force_x", *np.arange(5.0, 7.5, 0.005))
    assert 5 < force.max() < 9
    assert -2 < force.min() < 0


def test_the_rails_friction_costs_way():
    ends = [0.0, 3.0, 6.0]
    free, rubbing = (seen(rowed(rail_n=n, rail_at_rest_n=2 * n), "position", *ends) for n in (0.0, 0.3))
    assert 0 < rubbing[2] - rubbing[1] < 0.9 * (free[2] - free[1])


def test_the_fastest_gait_of_the_search_is_at_its_end_before_the_tank_is():
    experiment = load_experiment(shipped_experiments() / "rowing.toml").experiment
    rig = rowed(stroke_rad=np.radians(50.5), back_rad=np.radians(-64.3), hz=0.945)
    way = seen(rig, "position", 3.0 + experiment.trial.duration_s + 0.2)[0]
    assert 0.7 < way < experiment.trial.within["cameras.swimmer_x"][1]


def test_the_sensor_feels_the_rail_as_the_model_says_wherever_its_friction_comes_from():
    friction = load_effect("coulomb-friction", "joint")
    hidden = {
        "effect": "coulomb-friction",
        "site": "rail",
        "values": {"torque": 0.3, "transition_speed": 0.01},
    }
    rig = rowed(as_modelled=True, hide=[hidden], noise=0.0)
    # without servo, frames and cameras: the rig was told what its shafts do
    model = replace(swimmer_on_rail(), effects=()).with_values({**DESIGN, "servo_frequency": 300.0})
    time_s = np.arange(0, 4, 0.004)
    message = (BACK_RAD + STROKE_RAD * np.sin(2 * np.pi * HZ * time_s))[:, None]
    start = model.initial_state({}, first={"told": BACK_RAD, "x": 0.0})
    rubs = friction.attach("rail", Scale(), **hidden["values"])
    result = simulate(model, time_s, message, initial_state=start, effects=[rubs], substeps=8)
    begins = seen(rig, "position", 3.0)[0]
    assert np.abs(seen(rig, "position", *(3.0 + time_s)) - begins - result.outputs[:, 0]).max() < 0.005
    assert np.std(seen(rig, "force_x", *(3.0 + time_s)) - result.outputs[:, 1]) < 0.05 * np.std(
        result.outputs[:, 1]
    )


@pytest.mark.slow
def test_the_model_of_the_gap_is_the_rig_with_nothing_hidden_but_for_noise(tmp_path):
    made = run("rowing", dry_run=True, overrides=SHORT, seed=3, hide=["none"], results=tmp_path)
    asked = ask(made.run, None, workspace=shipped_experiments().parent)
    for trial in asked.dataset.trials:
        start = asked.model.initial_state(trial.condition, first={"told": trial.inputs[0, 0], "x": 0.0})
        result = simulate(asked.model, trial.time_s, trial.inputs, initial_state=start, substeps=8)
        way_m, force_n = np.sqrt(np.mean(np.square(trial.outputs - result.outputs), axis=0))
        assert way_m < 5e-4  # noise of the cameras: 1e-4
        assert force_n < 0.035  # noise of water and sensor: 0.028


def test_a_stroke_below_the_rails_stiction_does_not_move_the_carriage():
    where = seen(rowed(stroke_rad=np.radians(3)), "position", 3.0, 8.0)
    assert abs(where[1] - where[0]) < 0.01


def test_a_line_pulls_the_carriage_back_and_a_bumper_stops_it():
    rig = rowed(ends_m=(-0.1, 0.5))
    assert seen(rig, "position", 7.9)[0] == pytest.approx(0.5, abs=1e-9)
    rig.tow(0.5, 0.0, 0.2, 8.5)
    on_the_way = seen(rig, "position", 9.5, 11.2, 12.0)
    assert 0.2 < on_the_way[0] < 0.4
    assert np.abs(on_the_way[1:]).max() < 0.01


def test_a_rig_that_is_restored_goes_on_identically():
    rig = rowed()
    seen(rig, "position", 4.0)
    memory = json.loads(json.dumps(rig.snapshot()))
    after = seen(rig, "force_x", *np.arange(4.1, 6.0, 0.01))
    other = RailRig({"design": DESIGN}, np.random.default_rng(5))
    other.restore(memory)
    assert np.array_equal(seen(other, "force_x", *np.arange(4.1, 6.0, 0.01)), after)


def test_one_limb_rowing_turns_and_both_do_not():
    model = free_swimmer().with_values(DESIGN)
    yaw = [output.name for output in model.outputs].index("yaw")
    time_s = np.linspace(0, 4, 2001)
    both = BACK_RAD + STROKE_RAD * np.sin(2 * np.pi * HZ * time_s)
    for message, turns in ((np.full_like(both, BACK_RAD), True), (both, False)):
        start = np.zeros(len(model.states))
        start[[6, 10]] = BACK_RAD
        result = simulate(model, time_s, np.column_stack([both, message]), initial_state=start, substeps=2)
        assert result.finite
        assert (abs(result.outputs[-1, yaw]) > np.radians(10)) == turns


SHORT = ("cmaes.population=4", "cmaes.stop.iterations=2", "leaders.count=1", "leaders.repeats=2")


def test_candidates_that_leave_the_tank_are_stopped_and_the_search_goes_on(tmp_path):
    # the tank ends where nearly every candidate gets
    overrides = (*SHORT, 'trial.within={"cameras.swimmer_x" = [-0.1, 0.25]}')
    result = run("rowing", dry_run=True, overrides=overrides, seed=2, results=tmp_path)
    with_reason = [outcome for outcome in open_run(result.run).outcomes if outcome.status == "rejected"]
    assert with_reason
    assert all("is outside -0.1 ... 0.25: stopped" in outcome.reason for outcome in with_reason)
    assert result.best is not None
    assert result.best.value < 0.26


def test_a_guard_holds_while_the_search_looks_around_and_not_when_its_winner_is_measured_again(tmp_path):
    hard = 'cmaes.guard.limits={"wrench.force_x" = [-4, 1.0]}'
    result = run("rowing", dry_run=True, overrides=(*SHORT, hard), seed=1, results=tmp_path)
    measured = open_run(result.run)
    for outcome in measured.outcomes:
        peak = measured.signals(outcome.index)["wrench"].tared().column("force_x").max()
        if outcome.role == "measure" and outcome.status == "done":
            assert peak <= 1.0
        if outcome.role in ("fresh", "confirm"):
            assert outcome.status == "done"


def test_the_moment_in_a_beam_is_guarded_by_its_bend(tmp_path):
    soft = 'cmaes.guard.limits={"cameras.bend" = [-2, 0.3]}'
    result = run("rowing", dry_run=True, overrides=(*SHORT, soft), seed=1, results=tmp_path)
    measured = open_run(result.run)
    assert any("rad is outside -2 ... 0.3: stopped" in outcome.reason for outcome in measured.outcomes)
    for outcome in measured.outcomes:
        if outcome.status == "done" and outcome.role == "measure":
            assert measured.signals(outcome.index)["cameras"].column("bend").max() <= 0.3


def test_cameras_see_the_beam_bend_as_far_as_its_moment_says():
    rig = rowed(rail="locked")
    message = seen(rig, "link_qz", 4.0)[0], seen(rig, "link_qw", 4.0)[0]
    assert -2 * np.arctan2(*message) == pytest.approx(
        BACK_RAD + STROKE_RAD * np.sin(2 * np.pi * HZ), abs=0.35
    )
    times_s = np.arange(5.0, 7.0, 0.005)
    link, plate = (
        -2 * np.arctan2(seen(other, f"{part}_qz", *times_s), seen(other, f"{part}_qw", *times_s))
        for part in ("link", "plate")
        for other in [rowed(rail="locked")]
    )
    bend = plate - link
    assert 0.1 < bend.max() < 0.76 / 0.506  # stiff in opposite sense
    assert bend.min() < -0.1063 / 0.506  # buckled in equal sense


def test_no_candidate_goes_beyond_a_guarded_joint(tmp_path):
    tight = "cmaes.guard.limits={left = [-100, 0]}"
    result = run("rowing", dry_run=True, overrides=(*SHORT, tight), seed=1, results=tmp_path)
    for outcome in open_run(result.run).outcomes:
        if outcome.role == "measure":
            assert outcome.condition["beta"] - outcome.condition["alpha"] >= -100
            assert outcome.condition["beta"] + outcome.condition["alpha"] <= 0
