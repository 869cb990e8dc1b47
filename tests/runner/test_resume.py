"""Resuming by replay: the same run, bit for bit, wherever it was cut."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paddle_lab import Lab, experiment_with

from labrun.errors import RecordingError
from labrun.runner import LimitReached
from labrun.store.folder import RunFolder

CONDITIONS = [{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}, {"a": 30, "f": 2.0}]
CHANGES = {
    "rig__scene": {"plugin": "pond:Pond", "echo_n": 1.0},
    "trial__settle__below": None,
    "trial__repeats": {"min": 4, "max": 8, "standard_error": {"thrust": 0.002}},
    "trial__outliers": {"rule": "mad", "threshold": 2.0, "minimum": 3},
    "trial__reference": {"every": 4, "condition": {"a": 15, "f": 1.0}},
    "rig__devices__cell__lossy_trials": [5],
}


def values(outcomes):
    """Return what a run found, without what only says how it was stored."""
    return [replace(outcome, checkpoint=None) for outcome in outcomes]


def new_folder(path):
    return RunFolder.create(path, "paddle", "t = 1", {})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Run everything without interruption, once."""
    lab = Lab(new_folder(tmp_path_factory.mktemp("whole")), experiment_with(**CHANGES))
    result = lab.session.measure(CONDITIONS)
    return lab, result


@given(cuts=st.lists(st.integers(1, 9), max_size=5))
@settings(max_examples=8, deadline=None)
def test_a_run_cut_anywhere_and_resumed_is_identical_to_one_that_never_stopped(whole, tmp_path_factory, cuts):
    lab, result = whole
    path = new_folder(tmp_path_factory.mktemp("cut")).path
    for limit in cuts:
        try:
            Lab(RunFolder.open(path), experiment_with(**CHANGES), limit=limit).session.measure(CONDITIONS)
        except LimitReached:
            continue
    resumed = Lab(RunFolder.open(path), experiment_with(**CHANGES))
    again = resumed.session.measure(CONDITIONS)
    assert [values(m.outcomes) for m in again] == [values(m.outcomes) for m in result]
    assert resumed.folder.outcomes() == lab.folder.outcomes()


def test_the_uninterrupted_run_holds_what_makes_replay_hard(whole):
    lab, _ = whole
    statuses = {
        outcome.reason.split(":")[0] for outcome in lab.session.outcomes if outcome.status == "rejected"
    }
    assert statuses >= {"outlier", "device cell"}


def test_the_recorded_samples_are_identical_too(whole, tmp_path):
    from labrun.store import open_run

    lab, _ = whole
    folder = new_folder(tmp_path)
    with pytest.raises(LimitReached):
        Lab(folder, experiment_with(**CHANGES), limit=7).session.measure(CONDITIONS)
    Lab(RunFolder.open(folder.path), experiment_with(**CHANGES)).session.measure(CONDITIONS)
    index = len(lab.session.outcomes) - 1
    first, second = (open_run(path).signals(index)["cell"] for path in (lab.folder.path, folder.path))
    assert np.array_equal(first.values, second.values)
    assert np.array_equal(first.time_s, second.time_s)


def test_a_trial_that_vanished_from_the_middle_is_run_again_with_the_same_result(whole, tmp_path):
    lab, _ = whole
    folder = new_folder(tmp_path)
    with folder.lock():
        Lab(folder, experiment_with(**CHANGES)).session.measure(CONDITIONS)
    (folder.path / "trials" / "000006.h5").unlink()
    again = Lab(RunFolder.open(folder.path), experiment_with(**CHANGES))
    again.session.measure(CONDITIONS)
    assert again.session.new_trials == 1
    assert again.folder.outcomes() == lab.folder.outcomes()


def test_another_seed_is_found_out_before_anything_runs(whole, tmp_path):
    folder = new_folder(tmp_path)
    with pytest.raises(LimitReached):
        Lab(folder, experiment_with(**CHANGES), limit=6).session.measure(CONDITIONS)
    with pytest.raises(RecordingError, match="but the plan has"):
        Lab(RunFolder.open(folder.path), experiment_with(**CHANGES), seed=5).session.measure(CONDITIONS)
