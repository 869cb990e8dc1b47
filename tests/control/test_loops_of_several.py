"""Loops with several numbers of feedback and several variables to set."""

import numpy as np
import pytest
from plant_lab import PlantLab, experiment_with

from labrun.control.closed_loop import ClosedLoopRecorder
from labrun.control.feedbacks import COMPONENTS, OrientationFeedback, unit_quaternion
from labrun.errors import ExperimentError, SpecError

CONTROL = {"plugin": "pid", "p": 0.4, "output": "increment"}
BOTH = {
    "drives": ["u", "v"],
    "range": [-30, 30],
    "slew_per_s": 100,
    "reference": [
        {"plugin": "constant", "value": 10},
        {"plugin": "step", "before": 0, "after": -5, "at_s": 2},
    ],
    "feedback": [{"plugin": "latest", "channel": f"eye.{axis}", "unit": "deg"} for axis in ("roll", "pitch")],
    "controllers": {"P": CONTROL},
}


def lab_of(tmp_path, **changes):
    return PlantLab(tmp_path, track__loops={"pose": {**BOTH, **changes}})


def test_one_loop_brings_two_axes_where_each_should_be(tmp_path):
    lab = lab_of(tmp_path)
    (outcome,) = lab.run()
    assert outcome.status == "done"
    loop = lab.stream()
    assert loop.column("pose_feedback_roll")[-1] == pytest.approx(10.0, abs=0.05)
    assert loop.column("pose_drive_v")[-1] == pytest.approx(-5.0, abs=0.05)
    error = loop.column("pose_reference_pitch") - loop.column("pose_feedback_pitch")
    np.testing.assert_allclose(loop.column("pose_error_pitch"), error, atol=1e-12)
    assert dict(zip(loop.columns, loop.units, strict=True))["pose_requested_u"] == "deg"


def test_a_controller_of_the_whole_loop_sees_all_numbers_at_once_and_adds_its_own_channels(tmp_path):
    lab = lab_of(tmp_path, controllers={"P": {"plugin": "whole_loop:Mixer", "watch": "eye.pitch"}})
    lab.run()
    loop = lab.stream()
    np.testing.assert_allclose(
        loop.column("pose_requested_v"), loop.column("pose_reference_roll"), atol=1e-12
    )
    np.testing.assert_allclose(loop.column("pose_steps"), 1 + np.arange(len(loop.time_s)))
    seen = np.degrees(loop.column("pose_seen"))
    np.testing.assert_allclose(seen, loop.column("pose_feedback_pitch"), atol=1e-9)


def test_the_worst_that_a_loop_of_several_may_ask_for_is_checked_before_anything_moves(tmp_path):
    (track,) = [experiment_with(track__loops={"pose": BOTH}).track]
    assert set(track.steered) == {"u", "v"}
    assert track.channels[:3] == ("pose_reference_roll", "pose_reference_pitch", "pose_feedback_roll")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"reference": {"plugin": "constant", "value": 1}},
            "loop pose: its feedback is 2 numbers, its reference 1",
        ),
        ({"feedback": BOTH["feedback"][0], "reference": BOTH["reference"][0]}, "answers for one number each"),
    ],
)
def test_numbers_that_do_not_match_are_refused_before_the_first_trial(tmp_path, change, message):
    lab = lab_of(tmp_path, **change)
    with pytest.raises(SpecError, match=message):
        ClosedLoopRecorder(lab.experiment, lab.rig).require_makeable([{"controller": "P"}])


def test_a_body_that_no_tracker_follows_is_told_with_the_nearest_that_is_followed():
    units = {f"eye.{body}_{part}": "1" for body in ("lens", "base") for part in COMPONENTS}
    with pytest.raises(SpecError, match=r'no channel eye\.lans_qw\n.*; did you mean "eye\.lens"\?'):
        OrientationFeedback({"body": "eye.lans"}, units)


def test_an_orientation_is_of_length_one_and_on_one_side():
    assert unit_quaternion(-2.0, 0.0, 2.0, 0.0, body="eye.lens") == pytest.approx(
        (0.5**0.5, 0.0, -(0.5**0.5), 0.0)
    )


@pytest.mark.parametrize("lost", [(0.0, 0.0, 0.0, 0.0), (float("nan"), 0.0, 0.0, 1.0)])
def test_a_loop_on_a_tracker_that_lost_the_body_ends_the_run_and_says_so(lost):
    with pytest.raises(ExperimentError, match=r"lost the body eye\.lens"):
        unit_quaternion(*lost, body="eye.lens")
