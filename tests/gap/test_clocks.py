"""A clock that cannot be right is said, and a trial in which time jumps is not believed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import RecordingError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.gap.data_checks import with_sound_clocks
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.store import SignalInfo

from .benches import CONDITIONS, dry_friction, pendulum, recorded

STEP_S = 0.02


def trial(
    time_s: np.ndarray, *, condition: float = 1.0, repeat: int = 1, file: str | None = None
) -> FitTrial:
    flat = np.zeros((len(time_s), 1))
    path = None if file is None else Path(file)
    return FitTrial(f"f = {condition}", {"f": condition}, repeat, np.asarray(time_s), flat, flat, path)


def dataset(*trials: FitTrial) -> Dataset:
    signal = (SignalInfo("angle", "rad"),)
    return Dataset("x", Path("x"), "recording", signal, signal, trials)


def even(count: int = 200, step_s: float = STEP_S) -> np.ndarray:
    return step_s * np.arange(count)


def jumped(at: int, by_s: float = 3.0) -> np.ndarray:
    time_s = even()
    time_s[at:] += by_s
    return time_s


def test_a_trial_in_which_time_jumps_is_left_out_with_file_line_and_length() -> None:
    checked = with_sound_clocks(dataset(trial(even(), file="a.csv"), trial(jumped(101), file="b.csv")))
    assert [other.file for other in checked.dataset.trials] == [Path("a.csv")]
    assert "1 trial was left out" in checked.limitations[0]
    assert "b.csv:103 (3.02 s)" in checked.limitations[0]  # sample 102 stands below a header line
    assert checked.notes == ("b.csv:103: time goes on by 3.02 s; the usual step is 0.02 s",)


def test_without_a_file_the_trial_and_its_sample_are_named() -> None:
    checked = with_sound_clocks(dataset(trial(even()), trial(jumped(101), condition=2.0)))
    assert "f = 2.0, sample 102" in checked.limitations[0]


def test_where_time_jumps_in_every_trial_there_is_no_diagnosis() -> None:
    with pytest.raises(RecordingError, match=r"every trial.*b\.csv:52") as caught:
        with_sound_clocks(dataset(trial(jumped(50), file="b.csv")))
    assert "mend the times" in (caught.value.hint or "")


@settings(max_examples=50, deadline=None)
@given(at=st.integers(1, 199), by_s=st.floats(0.1, 1e4))
def test_a_jump_is_found_wherever_it_is(at: int, by_s: float) -> None:
    checked = with_sound_clocks(dataset(trial(even()), trial(jumped(at, by_s))))
    assert len(checked.dataset.trials) == 1


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 1000))
def test_a_jittering_clock_is_no_jump(seed: int) -> None:
    steps_s = STEP_S * np.random.default_rng(seed).uniform(0.5, 1.5, 200)
    checked = with_sound_clocks(dataset(trial(np.cumsum(steps_s))))
    assert len(checked.dataset.trials) == 1
    assert checked.limitations == () == checked.notes


def test_a_short_hole_is_noted_and_costs_no_trial() -> None:
    time_s = even(2000)
    time_s[900:] += 8 * STEP_S  # 0.16 of 40 s
    checked = with_sound_clocks(dataset(trial(time_s)))
    assert len(checked.dataset.trials) == 1
    assert "Short holes in the time of 1 trial" in checked.limitations[0]
    assert len(checked.notes) == 1


def test_times_that_are_uneven_on_purpose_are_kept_and_said() -> None:
    checked = with_sound_clocks(dataset(trial(np.geomspace(0.01, 10.0, 60))))
    assert len(checked.dataset.trials) == 1
    assert "Sampled unevenly" in checked.limitations[0]


def test_trials_of_one_sample_tell_nothing_about_a_clock() -> None:
    assert with_sound_clocks(dataset(trial(np.zeros(1)), trial(np.array([0.0, 9.0])))).limitations == ()


def test_a_repeat_whose_clock_runs_at_another_rate_is_named_with_what_to_do() -> None:
    slow = trial(1.02 * even(), repeat=2, file="slow.csv")
    checked = with_sound_clocks(dataset(trial(even()), slow, trial(even(), repeat=3)))
    assert len(checked.dataset.trials) == 3
    (message,) = checked.limitations
    assert "slow.csv (+2.0 %)" in message
    assert "f = 1.0" not in message  # the others are right
    assert "take the trials out" in message


def test_of_two_repeats_that_disagree_either_may_be_wrong() -> None:
    (message,) = with_sound_clocks(
        dataset(trial(even()), trial(1.02 * even(), repeat=2, file="slow.csv"))
    ).limitations
    assert "f = 1.0 (-2.0 %)" in message
    assert "slow.csv (+2.0 %)" in message


def test_other_conditions_may_be_sampled_at_another_rate() -> None:
    assert with_sound_clocks(dataset(trial(even()), trial(2 * even(), condition=2.0))).limitations == ()


@pytest.mark.slow
def test_a_jump_does_not_make_the_diagnosis_rule_out_what_is_there() -> None:
    data = recorded(dry_friction(0.006), conditions=CONDITIONS[:3])
    times = data.trials[3].time_s.copy()
    times[200:] += 3.0
    trials = (*data.trials[:3], replace(data.trials[3], time_s=times), *data.trials[4:])
    diagnosis = diagnose_dataset(replace(data, trials=trials), pendulum(), Options(places=False))
    assert str(diagnosis.causes[0].name) == "coulomb-friction at hinge"
    assert diagnosis.trials == 8
    assert any("time jumps there" in limitation for limitation in diagnosis.limitations)
    assert any("time goes on by 3.01 s" in note for note in diagnosis.notes)
