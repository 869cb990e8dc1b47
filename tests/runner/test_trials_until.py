"""Trials that go on until their numbers say so: judged by the cycle, kept by the cycle, taken up where they stopped."""

import numpy as np
import pytest
from paddle_lab import experiment_with
from pydantic import ValidationError

from labrun.errors import ExperimentError
from labrun.runner import RealClock, Rig, Session, UntilRecorder
from labrun.runner.until import CycleLog
from labrun.store import RunFolder, open_run

TIRING = {
    "trial__cycles": None,
    "trial__discard_cycles": None,
    "trial__repeats": 1,
    "trial__until": {"when": "thrust < 0.6 * median(first 5)", "max_cycles": 60, "keep_every": 10},
    "rig__scene__tires_s": 50.0,
    "rig__devices__cell__noise_n": 0.002,
}
CONDITION = [{"a": 20, "f": 1.0}]


@pytest.fixture
def tiring(lab):
    """Return a function that makes a lab whose paddle pushes less and less."""

    def make(folder=None, **changes):
        extra = {} if folder is None else {"folder": folder}
        made = lab(**extra, **{**TIRING, **changes})
        made.messages = []
        recorder = UntilRecorder(made.experiment, made.rig, made.folder, seed=1, phase=made.messages.append)
        made.session = Session(made.experiment, made.rig, made.folder, made.clock, 1, recorder=recorder)
        return made

    return make


def stored(folder):
    """Return the outcome of the only trial, and all its signals."""
    with open_run(folder.path) as run:
        return run.outcomes[0], run.tables(0) if hasattr(run, "tables") else run.signals(0)


def test_it_ends_with_the_first_cycle_for_which_the_condition_holds(tiring):
    lab = tiring()
    lab.session.measure(CONDITION)
    outcome, signals = stored(lab.folder)
    numbers = signals["cycles"].column("thrust")
    assert outcome.objectives["cycles"] == len(numbers) == outcome.duration_s
    assert not outcome.censored
    held = numbers < 0.6 * np.median(numbers[:5])
    assert held[-1] and not held[:-1].any()
    # It tires by exp(-t / 50 s): to 0.6 of what it was about the third cycle after 50 ln(1/0.6) = 25.5 s more.
    assert len(numbers) == pytest.approx(3 + 25.5, abs=2)
    assert outcome.objectives["thrust"] == pytest.approx(np.mean(numbers))
    np.testing.assert_allclose(signals["cycles"].time_s, np.arange(1, len(numbers) + 1), atol=1e-6)


def test_reaching_the_most_cycles_is_censored(tiring):
    lab = tiring(rig__scene__tires_s=None)
    (result,) = lab.session.measure(CONDITION)
    assert result.outcomes[0].censored
    assert result.mean("cycles") == 60
    assert "cycle 60 of at most 60" in lab.messages


def test_samples_are_kept_of_one_cycle_in_so_many_and_dated_by_the_motion(tiring):
    lab = tiring()
    lab.session.measure(CONDITION)
    cell = stored(lab.folder)[1]["cell"]
    assert sorted(set(np.floor(cell.time_s + 1e-9))) == [0, 10, 20]
    first = cell.between(0.0, 1.0)
    assert len(first) == pytest.approx(100, abs=2)
    phase = np.cos(2 * np.pi * first.time_s)  # of the rate of a sine that begins with the cycle
    assert np.corrcoef(first.column("force_x"), phase)[0, 1] > 0.99


SPARING = {**TIRING["trial__until"], "judge_every": 5}


def test_cycles_that_nobody_judges_are_moved_and_count_as_the_one_before(tiring):
    every, sparing = tiring(), tiring(trial__until=SPARING)
    for lab in (every, sparing):
        lab.session.measure(CONDITION)
    (whole, measured), (outcome, signals) = stored(every.folder), stored(sparing.folder)
    numbers = signals["cycles"].column("thrust")
    assert outcome.objectives["cycles"] == len(numbers) == outcome.duration_s
    assert len(numbers) % 5 == 1  # it ends with a cycle that was measured
    assert 0 <= len(numbers) - whole.objectives["cycles"] < 6
    np.testing.assert_allclose(numbers[:10], measured["cycles"].column("thrust")[:10], rtol=0.05)
    later = numbers[10 : len(numbers) - 1].reshape(-1, 5)
    assert (later == later[:, :1]).all()
    assert (np.diff(later[:, 0]) < 0).all()
    # the time that nobody measured has passed: it tires by exp(-t / 50 s)
    assert later[-1, 0] / later[0, 0] == pytest.approx(np.exp(-5 * (len(later) - 1) / 50.0), rel=0.05)


@pytest.mark.parametrize("judge_every", [4, 5, 10])
def test_samples_are_kept_of_the_same_cycles_however_many_are_judged(tiring, judge_every):
    lab = tiring(
        rig__scene__tires_s=None, trial__until={**SPARING, "max_cycles": 40, "judge_every": judge_every}
    )
    lab.session.measure(CONDITION)
    assert sorted(set(np.floor(stored(lab.folder)[1]["cell"].time_s + 1e-6))) == [0, 10, 20, 30]


def test_what_is_judged_less_often_than_the_motion_goes_out_is_refused(tiring):
    with pytest.raises(ValidationError, match="is above keep_every = 10"):
        tiring(trial__until={**SPARING, "judge_every": 11})


@pytest.mark.parametrize(("until", "killed_after"), [
    *((TIRING["trial__until"], cycles) for cycles in (3, 10, 17)), (SPARING, 16), (SPARING, 26),
])  # fmt: skip
def test_a_killed_dry_run_goes_on_to_the_same_numbers(tiring, tmp_path, monkeypatch, until, killed_after):
    def tiring_until(*folder):
        return tiring(*folder, trial__until=until)

    whole = tiring_until()
    whole.session.measure(CONDITION)
    folder = RunFolder.create(tmp_path / "other", "paddle", "title = 'x'", {"seed": 1})
    append = CycleLog.append

    def killed(log, values, samples):
        append(log, values, samples)
        if log.cycles == killed_after:
            raise ExperimentError("the process is gone")

    with monkeypatch.context() as patch:
        patch.setattr(CycleLog, "append", killed)
        with pytest.raises(ExperimentError):
            tiring_until(folder).session.measure(CONDITION)
    again = tiring_until(RunFolder.open(folder.path))
    again.session.measure(CONDITION)
    (before, numbers), (after, repeated) = stored(whole.folder), stored(folder)
    assert after.objectives == before.objectives
    for name in numbers:
        np.testing.assert_array_equal(repeated[name].values, numbers[name].values)
    assert not list(folder.path.glob("cycles/*"))


def real_lab(folder, cycles):
    """Return a session on the paddle's own devices, in real time."""
    experiment = experiment_with(
        **{
            **TIRING, "trial__settle": None, "trial__tare": None, "trial__safe_pose_deg": None,
            "trial__until": {"when": f"cycle >= {cycles}", "max_cycles": 30, "keep_every": 4},
        }
    )  # fmt: skip
    clock = RealClock()
    rig = Rig.build(experiment, clock=clock, seed=1, dry_run=False)
    recorder = UntilRecorder(experiment, rig, folder, seed=1, phase=lambda text: None)
    return rig, Session(experiment, rig, folder, clock, 1, recorder=recorder)


def test_on_a_bench_it_goes_on_with_the_cycle_after_the_last_one_kept(folder, monkeypatch):
    append, seen = CycleLog.append, []

    def killed(log, values, samples):
        append(log, values, samples)
        seen.append(values["thrust"])
        if len(seen) == 6:
            raise ExperimentError("the cable is out")

    monkeypatch.setattr(CycleLog, "append", killed)
    conditions = [{"a": 2, "f": 4.0}]  # in real time: a busy machine may stand still for a tenth of a second
    for _ in range(2):
        rig, session = real_lab(RunFolder.open(folder.path) if seen else folder, cycles=9)
        with rig:
            if len(seen) < 6:
                with pytest.raises(ExperimentError, match="cable"):
                    session.measure(conditions)
            else:
                session.measure(conditions)
    assert len(seen) == 9
    outcome, signals = stored(folder)
    assert outcome.objectives["cycles"] == 9
    np.testing.assert_array_equal(signals["cycles"].column("thrust"), seen)
    cycles_kept = sorted(set(np.floor(signals["cell"].time_s * 4 + 1e-6)))
    assert cycles_kept == [0, 4, 8]


def test_a_log_of_another_specimen_is_set_aside(tmp_path):
    path = tmp_path / "000000.jsonl"
    first = CycleLog(path, {"mounting": 1}, durable=False)
    first.begin(0.0, {})
    first.append({"thrust": 1.0}, {})
    first.close()
    assert CycleLog(path, {"mounting": 1}, durable=False).cycles == 1
    assert CycleLog(path, {"mounting": 2}, durable=False).cycles == 0
    assert (tmp_path / "000000-set-aside-1.jsonl").exists()
