"""Measuring conditions: repeats, order, references, outliers."""

import itertools

import numpy as np
import pytest

from labrun.errors import ExperimentError, SpecError
from labrun.experiment import RepeatRule
from labrun.runner import LimitReached
from labrun.store import open_run

CONDITIONS = [{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}, {"a": 30, "f": 2.0}]


def test_every_condition_is_measured_as_often_as_the_file_says(lab):
    result = lab().session.measure(CONDITIONS)
    assert [m.condition for m in result] == CONDITIONS
    assert [len(m.accepted) for m in result] == [2, 2, 2]
    assert result[2].mean("thrust") > result[1].mean("thrust") > result[0].mean("thrust")


def test_the_measured_force_is_that_of_the_bench(lab):
    (result,) = lab(rig__devices__cell__noise_n=0.0, rig__scene__gain=0.5).session.measure(
        [{"a": 20, "f": 1.0}]
    )
    # Force is 0.5 N s/rad times the rate of a 20 deg, 1 Hz sine; the standing 0.2 N is tared away.
    expected = 0.5 * 2 * np.pi * np.radians(20) / np.sqrt(2)
    assert result.mean("thrust") == pytest.approx(expected, rel=0.01)
    assert result.outcomes[0].tare["cell.force_x"] == pytest.approx(0.2, abs=1e-6)


def test_blocks_hold_every_condition_once_and_are_shuffled_anew(lab):
    session = lab(trial__repeats=4).session
    conditions = [{"a": float(a), "f": 1.0} for a in range(5, 13)]
    session.measure(conditions)
    order = [outcome.condition["a"] for outcome in session.outcomes]
    blocks = [order[i : i + 8] for i in range(0, 32, 8)]
    assert all(sorted(block) == [c["a"] for c in conditions] for block in blocks)
    assert len({tuple(block) for block in blocks}) == 4
    assert [o.repeat for o in session.outcomes] == [k for k in range(4) for _ in range(8)]


def test_the_listed_order_is_kept_where_asked_for(lab):
    session = lab().session
    session.measure(CONDITIONS, order="as-listed")
    assert [o.condition for o in session.outcomes] == CONDITIONS * 2


def test_repeats_go_on_until_the_standard_error_is_small_enough(lab):
    rule = RepeatRule(min=2, max=40, standard_error={"thrust": 0.003})
    lab = lab(rig__devices__cell__noise_n=0.01, trial__cycles=2, trial__discard_cycles=1)
    (loose,) = lab.session.measure([{"a": 10, "f": 1.0}], repeats=RepeatRule(min=2, max=40))
    assert len(loose.accepted) == 2
    (tight,) = lab.session.measure([{"a": 10, "f": 1.0}], repeats=rule)
    assert tight.standard_error("thrust") <= 0.003 or len(tight.accepted) == 40
    before = tight.values("thrust")[:-1]
    if len(before) >= 2:
        assert np.std(before, ddof=1) / np.sqrt(len(before)) > 0.003


def test_repeats_end_at_the_maximum(lab):
    rule = RepeatRule(min=2, max=5, standard_error={"thrust": 1e-9})
    (result,) = lab().session.measure([{"a": 10, "f": 1.0}], repeats=rule)
    assert len(result.accepted) == 5


def test_a_reference_trial_comes_first_and_then_every_so_many(lab):
    session = lab(trial__reference={"every": 4, "condition": {"a": 15, "f": 1.0}}).session
    session.measure(CONDITIONS)
    session.measure(CONDITIONS, role="fresh")
    roles = [outcome.role for outcome in session.outcomes]
    assert roles[:7] == ["reference", *["measure"] * 4, "reference", "measure"]
    assert "reference" not in roles[9:]
    runs = [len(list(group)) for key, group in itertools.groupby(roles) if key == "measure"]
    assert max(runs) == 4


def test_an_outlier_is_rejected_by_the_declared_rule_kept_and_replaced(lab):
    lab = lab(
        trial__repeats=6,
        trial__outliers={"rule": "mad", "threshold": 5.0, "objective": "thrust"},
        trial__tare=None,
        rig__devices__cell__spike_trials=[2],
    )
    (result,) = lab.session.measure([{"a": 10, "f": 1.0}])
    rejected = [outcome for outcome in result.outcomes if outcome.status == "rejected"]
    assert [outcome.index for outcome in rejected] == [2]
    assert rejected[0].reason.startswith("outlier: thrust = ")
    assert len(result.accepted) == 6
    assert lab.folder.outcomes()[2].status == "rejected"
    assert rejected[0].objectives["thrust"] > 4


def test_without_a_rule_nothing_is_rejected(lab):
    (result,) = lab(trial__repeats=6, trial__tare=None, rig__devices__cell__spike_trials=[2]).session.measure(
        [{"a": 10, "f": 1.0}]
    )
    assert len(result.outcomes) == len(result.accepted) == 6


def test_an_objective_that_is_no_number_fails_the_trial_by_name_and_is_never_averaged(lab):
    lab = lab(objectives__lift={"plugin": "nan_objective:Nothing", "channel": "cell.force_x"})
    (result,) = lab.session.measure([{"a": 10, "f": 1.0}])
    assert {outcome.status for outcome in result.outcomes} == {"failed"}
    assert "objective lift of cell.force_x is nan" in result.outcomes[0].reason
    with pytest.raises(ExperimentError, match="no accepted trial of a = 10, f = 1: objective lift"):
        result.mean("lift")
    assert len(lab.folder.outcomes()) == len(result.outcomes)


def test_the_limit_on_new_trials_ends_the_session_resumably(lab):
    lab = lab(limit=3)
    with pytest.raises(LimitReached):
        lab.session.measure(CONDITIONS)
    assert len(lab.folder.outcomes()) == 3


def test_names_the_rig_does_not_have_are_all_reported_before_anything_moves(lab):
    with pytest.raises(SpecError) as caught:
        lab(
            objectives__thrust__channel="cell.force_z",
            trial__safe_pose_deg={"fin": 0},
            trial__settle__channel="cell.lift",
        )
    for text in ("cell.force_z", "trial.safe_pose_deg.fin", "cell.lift", "cell.force_x"):
        assert text in str(caught.value)


@pytest.mark.parametrize("name", ["command", "settle", "trial", "wrench/left"])
def test_a_device_whose_samples_could_not_be_stored_is_reported_before_anything_moves(lab, name):
    with pytest.raises(SpecError, match=f"cannot be stored under the name '{name}'"):
        lab(**{f"rig__devices__{name}": {"plugin": "pond:Cell"}})


def test_progress_hears_of_every_trial_and_of_what_happens_now(lab):
    class Listener:
        def __init__(self):
            self.phases, self.trials, self.totals = [], [], []

        def total(self, trials):
            self.totals.append(trials)

        def phase(self, text):
            self.phases.append(text)

        def trial(self, outcome, done, total, remaining_s):
            self.trials.append((outcome.index, done, total, remaining_s))

        def best(self, condition, value, unit):
            pass

        def note(self, text):
            pass

    listener = Listener()
    session = lab(progress=listener).session
    session.expect(6)
    session.measure(CONDITIONS)
    assert listener.totals == [6]
    assert [(i, d, t) for i, d, t, _ in listener.trials] == [(i, i + 1, 6) for i in range(6)]
    assert listener.trials[-1][3] == 0.0
    assert listener.phases[:5] == ["prepare", "settle", "record", "safe pose", "store"]


def test_without_a_gait_sensors_are_recorded_and_nothing_is_driven(lab):
    still = {"gait": None, "trial__cycles": None, "trial__discard_cycles": None, "trial__duration_s": 2}
    lab = lab(**still, trial__safe_pose_deg=None, rig__devices__cell__noise_n=0.0)
    (result,) = lab.session.measure([{"a": 1.0}])
    assert result.values("thrust") == pytest.approx([0.0, 0.0], abs=1e-6)  # the standing force is tared away
    with open_run(lab.folder.path) as run:
        assert run.command(0).columns == ()
        assert len(run.signals(0)["cell"].time_s) > 100
