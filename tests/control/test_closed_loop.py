"""Loops closed on a bench: simulated devices, in simulated and in real time."""

import numpy as np
import pytest
from plant_lab import PlantLab

from labrun.errors import ExperimentError
from labrun.runner import RealClock


def test_two_loops_at_once_bring_each_axis_where_it_should_be(tmp_path):
    lab = PlantLab(tmp_path, rig__scene__push_rad=0.1)
    (outcome,) = lab.run()
    assert outcome.status == "done"
    loop = lab.stream()
    assert loop.column("roll_feedback")[-1] == pytest.approx(10.0, abs=0.05)
    assert loop.column("roll_drive")[-1] == pytest.approx(10.0 - np.degrees(0.1), abs=0.05)
    before, after = loop.time_s < 2.0, loop.time_s > 3.8
    assert np.abs(loop.column("pitch_feedback")[before]).max() < 1e-6
    assert loop.column("pitch_feedback")[after].mean() == pytest.approx(-5.0, abs=0.5)


def test_every_step_is_recorded_with_its_units(tmp_path):
    lab = PlantLab(tmp_path)
    lab.run()
    loop = lab.stream()
    assert len(loop.time_s) == 80
    np.testing.assert_allclose(loop.time_s, 0.05 * np.arange(80), atol=1e-9)
    units = dict(zip(loop.columns, loop.units, strict=True))
    assert units["roll_error"] == units["roll_drive"] == "deg"
    assert units["latency_s"] == units["late_s"] == "s"
    np.testing.assert_allclose(
        loop.column("roll_error"), loop.column("roll_reference") - loop.column("roll_feedback"), atol=1e-9
    )
    assert not loop.column("missed").any()
    np.testing.assert_allclose(loop.column("late_s"), 0.0, atol=1e-9)


def test_the_stored_command_is_what_the_actuator_did(tmp_path):
    lab = PlantLab(tmp_path)
    (outcome,) = lab.run()
    command, loop = lab.command(), lab.stream()
    roll = np.interp(loop.time_s, command.time_s, np.degrees(command.column("roll")))
    # A step's goal is reached one period later.
    np.testing.assert_allclose(roll[1:], loop.column("roll_drive")[:-1], atol=1e-9)
    seen = lab.stream(device="eye")
    inside = (seen.time_s > 0) & (seen.time_s < outcome.duration_s)
    expected = np.interp(seen.time_s[inside], command.time_s, command.column("roll"))
    np.testing.assert_allclose(seen.column("roll")[inside], expected, atol=1e-9)


@pytest.mark.parametrize("slew", [None, 30.0])
def test_a_wild_controller_stays_within_range_slew_and_limits(tmp_path, slew):
    lab = PlantLab(
        tmp_path,
        track__loops__roll__controllers__P={"plugin": "plant_bench:WildController"},
        track__loops__roll__slew_per_s=slew,
        rig__devices__servos__limits={"angle_deg": [-45, 45], "speed_deg_s": 1201},
    )
    (outcome,) = lab.run()
    assert outcome.status == "done"
    drive = lab.stream().column("roll_drive")
    assert np.abs(drive).max() <= 30.0
    assert np.abs(lab.stream().column("roll_requested")).max() == 1e6
    rate = np.abs(np.diff(drive)).max() / 0.05
    assert rate == pytest.approx(1200.0) if slew is None else rate <= 30.0 + 1e-9


def test_a_controller_that_asks_for_no_number_ends_the_run_with_its_loop_named(tmp_path):
    lab = PlantLab(tmp_path, track__loops__roll__controllers__P={"plugin": "plant_bench:LostController"})
    with pytest.raises(ExperimentError, match=r"loop roll: controller \w+ asks for u = nan"):
        lab.run()


def test_gains_are_swept_by_naming_them_in_the_conditions(tmp_path):
    lab = PlantLab(
        tmp_path,
        track__conditions=[{"controller": "P", "gain": gain} for gain in (0.05, 0.4)],
        track__loops__roll__controllers__P={"plugin": "pid", "p": "2 * gain", "output": "increment"},
    )
    lab.run()
    slow, quick = (np.abs(lab.stream(index).column("roll_error")).mean() for index in (0, 1))
    assert quick < 0.5 * slow


def test_the_same_seed_gives_the_same_samples(tmp_path):
    labs = [PlantLab(tmp_path / name, rig__devices__eye__noise_rad=0.01) for name in "cd"]
    for lab in labs:
        lab.run()
    first, second = (lab.stream().values for lab in labs)
    np.testing.assert_array_equal(first, second)


def test_a_controller_remembers_nothing_of_the_trial_before(tmp_path):
    lab = PlantLab(tmp_path, track__conditions=[{"controller": "P"}, {"controller": "P"}])
    lab.run()
    for index in (0, 1):
        assert lab.stream(index).column("pitch_requested")[0] == pytest.approx(0.0, abs=1e-6)


def test_in_real_time_steps_come_when_they_are_due(tmp_path):
    lab = PlantLab(tmp_path, clock=RealClock(), trial__duration_s=1.5)
    (outcome,) = lab.run()
    loop = lab.stream()
    assert outcome.duration_s == 1.5
    steps = len(loop.time_s) + loop.lost
    assert steps == 30
    assert np.all(loop.column("latency_s") > 0.0)
    assert np.all(loop.column("late_s") >= 0.0)
    assert loop.column("roll_feedback")[-1] > 5.0


def test_late_steps_are_recorded_and_never_caught_up_in_a_burst(tmp_path):
    lab = PlantLab(
        tmp_path,
        clock=RealClock(),
        trial__duration_s=1.5,
        track__loops__roll__controllers__P={"plugin": "plant_bench:SlowController", "think_s": 0.12},
    )
    outcome = lab.run()[0]
    assert outcome.status == "rejected"
    assert "steps came too late for 20 Hz" in outcome.reason
    loop = lab.stream()
    assert loop.column("missed").all()
    assert np.diff(loop.time_s).min() >= 0.12
    assert loop.lost > 0
    assert len(loop.time_s) + loop.lost == 30
    assert np.diff(lab.command().time_s).min() > 0


def test_a_trial_may_miss_what_the_file_allows(tmp_path):
    lab = PlantLab(
        tmp_path,
        clock=RealClock(),
        trial__duration_s=0.6,
        track__max_missed_share=1.0,
        track__loops__roll__controllers__P={"plugin": "plant_bench:SlowController", "think_s": 0.08},
    )
    (outcome,) = lab.run()
    assert outcome.status == "done"


def test_a_gait_that_leaves_a_limit_ends_the_run_and_what_was_sent_is_kept(tmp_path):
    """The plan would have refused it; the last check on each piece does so too, with the actuators stopped."""
    lab = PlantLab(
        tmp_path,
        rig__devices__servos__limits={"angle_deg": [-5, 5], "speed_deg_s": 200},
        track__loops__roll__reference={"plugin": "constant", "value": 20},
    )
    with pytest.raises(ExperimentError, match=r"angle of roll .* is above the limit of 5 deg"):
        lab.run()
    (outcome,) = lab.folder.outcomes().values()
    assert outcome.status == "failed"
    assert np.degrees(lab.command().column("roll")).max() <= 5.0 + 1e-9
