"""Whatever an objective does, the recording is kept."""

import pytest

from labrun.errors import ExperimentError
from labrun.runner.measurement import ObjectiveEvaluation
from labrun.store.reading import open_run

ONE = [{"a": 10, "f": 1.0}]


@pytest.mark.parametrize(
    ("plugin", "cause"),
    [("Raising", "RuntimeError: the reference file is gone"), ("Forgetful", "TypeError: ")],
)
def test_an_objective_that_raises_anything_fails_its_trial_by_name_and_keeps_the_samples(lab, plugin, cause):
    lab = lab(
        trial__repeats=1,
        objectives__lift={"plugin": f"bad_objectives:{plugin}", "channel": "cell.force_x"},
    )
    (result,) = lab.session.measure(ONE)
    outcome = result.outcomes[0]
    assert outcome.status == "failed"
    assert f"objective lift of cell.force_x: {cause}" in outcome.reason
    with open_run(lab.folder.path) as run:
        assert len(run.signals(0)["cell"].values) >= 300


def test_an_objective_that_raises_the_same_again_and_again_ends_the_run_with_its_file_and_line(lab):
    lab = lab(
        trial__repeats=1,
        objectives__lift={"plugin": "bad_objectives:Raising", "channel": "cell.force_x"},
    )
    with pytest.raises(ExperimentError, match=r"5 trials failed.*the same way.*bad_objectives.py, line 16"):
        lab.session.measure([{"a": a, "f": 1.0} for a in range(1, 9)])
    assert [outcome.status for outcome in lab.folder.outcomes().values()] == ["failed"] * 5


def test_a_judgement_that_breaks_altogether_keeps_the_recording(lab, monkeypatch):
    def broken(self, *_):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(ObjectiveEvaluation, "evaluate", broken)
    lab = lab(trial__repeats=1)
    with pytest.raises(RuntimeError, match="out of memory"):
        lab.session.measure(ONE)
    (outcome,) = lab.folder.outcomes().values()
    assert (outcome.status, outcome.reason) == ("failed", "cut short: out of memory")
