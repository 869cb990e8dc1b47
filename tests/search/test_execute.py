import json
import os
import shutil
import signal
from types import SimpleNamespace

import pytest
from analytic_bench import search_experiment

from labrun.app.check import check, require_room
from labrun.app.resume import resume
from labrun.app.run import run as execute
from labrun.errors import LabrunError, PlanError, RequestError, SpecError
from labrun.experiment import load_experiment
from labrun.report.terminal import plan_text
from labrun.runner import Interrupted, Rig, SilentProgress
from labrun.search import Best, RunResult
from labrun.store import RunFolder, find_data


def objectives(run):
    return {i: (o.condition, o.role, o.objectives) for i, o in RunFolder.open(run).outcomes().items()}


def test_a_sweep_runs_to_its_honest_best_its_file_and_its_picture(write, dry_run, recorder):
    result = dry_run(write("sweep"), progress=recorder, draw=True)
    assert result.finished
    assert (result.run / "run.h5").is_file()
    assert result.figure is not None
    assert result.figure.read_bytes().startswith(b"\x89PNG")
    assert result.done == 12 + 6 + 3 == recorder.expected
    assert result.best.parameters == {"a": 60.0, "f": 1.4}
    low, high = result.best.ci95
    assert low < result.best.value < high
    assert result.best.unit == "N"
    assert recorder.bests
    provenance = RunFolder.open(result.run).provenance
    assert provenance["seed"] == 5
    assert provenance["dry_run"] is True
    assert set(provenance["devices"]) == {"tail", "wrench"}


def test_the_json_of_a_run_is_what_scripts_are_promised(tmp_path):
    best = Best({"a": 60.0}, "thrust", 0.5, (0.4, 0.6), "N", 0.7, trials=5)
    result = RunResult(tmp_path, 10, 2, 1, best, None, finished=True)
    assert json.loads(json.dumps(result.to_json())) == {
        "run": str(tmp_path),
        "trials": {"done": 10, "rejected": 2, "failed": 1},
        "best": {
            "parameters": {"a": 60.0},
            "objective": {"value": 0.5, "ci95": [0.4, 0.6], "unit": "N"},
            "luckiest": 0.7,
        },
    }


def test_without_a_goal_there_is_no_best(write, dry_run, tmp_path):
    path = write("sweep")
    path.write_text(path.read_text().replace('goal = "maximise"\n', ""))
    result = dry_run(path)
    assert result.best is None
    assert result.done == 12
    assert result.to_json()["best"] is None
    assert "next" not in result.to_text()


FIT = """
[fit]
method = "least-squares"
after_run = {}
[fit.settings]
inputs = {{ a = "gait.a" }}
outputs = {{ thrust = "wrench.force_x" }}
"""


def test_without_a_goal_the_fit_of_the_file_is_what_comes_next(write, dry_run, tmp_path):
    path = write("sweep", FIT.format("false"))
    path.write_text(path.read_text().replace('goal = "maximise"\n', ""))
    result = dry_run(path)
    assert f"next      labrun fit {result.run.parent.name}\n" in result.to_text()
    assert not (result.run / "fit").exists()


def test_a_run_is_fitted_as_soon_as_it_is_finished_where_the_file_asks_for_it(write, dry_run):
    path = write("sweep", FIT.format("true") + 'baskets = {"a" = ["a"]}\n')
    stopped = dry_run(path, limit=5)
    assert not (stopped.run / "fit").exists()
    result = resume(stopped.run)
    assert "fitted to" in result.to_text()
    assert (result.run / "fit" / "least-squares.json").is_file()


def test_the_bench_is_let_go_before_the_run_is_fitted(write, dry_run, monkeypatch):
    messages = []
    close = Rig.__exit__
    monkeypatch.setattr(
        Rig, "__exit__", lambda rig, *error: (messages.append("let go"), close(rig, *error))[1]
    )
    monkeypatch.setattr(
        "labrun.app.fit.find_data", lambda *asked: (messages.append("fit"), find_data(*asked))[1]
    )
    dry_run(write("sweep", FIT.format("true")))
    assert messages == ["let go", "fit"]


def test_ctrl_c_while_it_is_fitted_says_that_the_run_is_kept(write, dry_run, monkeypatch):
    def interrupting(*asked):
        raise KeyboardInterrupt

    monkeypatch.setattr("labrun.app.fit.find_data", interrupting)
    with pytest.raises(Interrupted, match="the run is finished and kept") as caught:
        dry_run(write("sweep", FIT.format("true")))
    assert "labrun fit " in caught.value.hint


def test_a_fit_that_fails_leaves_the_finished_run(write, dry_run, recorder):
    path = write("sweep", FIT.format("true").replace("gait.a", "gait.nothing"))
    result = dry_run(path, progress=recorder)
    assert result.finished
    assert any("the run is kept, and could not be fitted" in note for note in recorder.notes)


@pytest.mark.parametrize(("kind", "limit"), [("sweep", 5), ("cmaes", 9), ("cmaes", 30)])
def test_a_limited_run_resumes_to_the_result_of_an_uninterrupted_one(write, dry_run, kind, limit, recorder):
    path = write(kind)
    whole = dry_run(path, results="whole")
    part = dry_run(path, results="part", limit=limit, progress=recorder)
    assert not part.finished
    assert part.done == limit
    assert any(f"labrun resume {part.run}" in note for note in recorder.notes)
    resumed = resume(part.run, draw=False)
    assert resumed.best == whole.best
    assert objectives(resumed.run) == objectives(whole.run)
    for state in (whole.run / "search").glob("*.json"):
        assert state.read_bytes() == (resumed.run / "search" / state.name).read_bytes()


class InterruptAt(SilentProgress):
    def __init__(self, trial):
        self.left = trial

    def trial(self, outcome, done, total, remaining_s):
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_keeps_the_trials_and_says_how_to_go_on(write, dry_run, tmp_path):
    path = write("sweep")
    with pytest.raises(Interrupted) as caught:
        dry_run(path, progress=InterruptAt(4))
    (run,) = (tmp_path / "results" / "sweep").iterdir()
    assert f"labrun resume {run}" in str(caught.value)
    assert len(objectives(run)) == 4
    assert [event["event"] for event in RunFolder.open(run).journal.events()][-1] == "interrupted"
    assert resume(run, draw=False).best == dry_run(path, results="whole").best


class FailAt(SilentProgress):
    def trial(self, outcome, done, total, remaining_s):
        if done == 3:
            raise LabrunError("the pump has stopped", hint="switch it on")


def test_a_failure_keeps_the_trials_and_says_how_to_go_on(write, dry_run, tmp_path):
    with pytest.raises(LabrunError, match="the pump has stopped") as caught:
        dry_run(write("sweep"), progress=FailAt())
    (run,) = (tmp_path / "results" / "sweep").iterdir()
    assert "switch it on" in str(caught.value)
    assert f"labrun resume {run}" in str(caught.value)
    assert resume(run, draw=False).finished


def test_resuming_a_finished_run_says_so_and_gives_its_result(write, dry_run, recorder):
    result = dry_run(write("sweep"))
    again = resume(result.run, progress=recorder, draw=False)
    assert again == result
    assert "is finished" in recorder.notes[0]
    assert recorder.trials == 0


def test_a_changed_experiment_file_is_refused_with_the_keys_that_changed(write, dry_run):
    path = write("sweep")
    part = dry_run(path, limit=3)
    path.write_text(path.read_text().replace("repeats = 2", "repeats = 4"))
    with pytest.raises(RequestError, match="has changed") as caught:
        resume(part.run, draw=False)
    assert "trial.repeats.min: 2 then, 4 now" in str(caught.value)
    assert "--accept-changed-spec" in str(caught.value)


def test_a_changed_file_that_is_accepted_leaves_the_run_with_the_specification_it_began_with(
    write, dry_run, recorder
):
    path = write("sweep")
    whole = dry_run(path, results="whole")
    part = dry_run(path, limit=3)
    path.write_text(path.read_text().replace("repeats = 2", "repeats = 4"))
    result = resume(part.run, progress=recorder, accept_changed_spec=True, draw=False)
    assert result.done == whole.done
    assert result.best == whole.best
    assert "has changed" in recorder.notes[0]


def test_a_comment_in_the_experiment_file_is_no_change(write, dry_run):
    path = write("sweep")
    part = dry_run(path, limit=3)
    path.write_text("# seen on Monday\n" + path.read_text())
    assert resume(part.run, draw=False).finished


def test_a_plan_outside_a_limit_is_refused_before_anything_is_written(write, dry_run, tmp_path):
    path = write("sweep")
    path.write_text(path.read_text().replace("[30, 45, 60]", "[30, 45, 70]"))
    with pytest.raises(PlanError, match="70"):
        dry_run(path)
    assert not (tmp_path / "results").exists()


def test_a_reference_outside_a_limit_is_refused_as_well(write, dry_run):
    path = write("sweep", extra="[trial.reference]\nevery = 5\ncondition = { a = 80, f = 1 }\n")
    with pytest.raises(PlanError, match="80"):
        dry_run(path)


def test_the_plan_of_a_search_counts_what_its_stop_rules_allow(write):
    plan = check(load_experiment(write("cmaes")))
    assert plan.trials == 3 * 6 * 2 + 3 * 3


def test_a_seed_that_is_not_given_is_drawn_and_stored(write, tmp_path):
    loaded = load_experiment(write("sweep"))
    seeds = set()
    for name in ("one", "two"):
        result = execute(loaded, results=tmp_path / name, dry_run=True, limit=1, draw=False)
        seeds.add(RunFolder.open(result.run).provenance["seed"])
    assert len(seeds) == 2


def test_the_trials_of_a_search_are_promised_as_the_most_there_can_be():
    from labrun.search import most_trials

    variables = {"a": {"from": 0, "to": 1}, "b": {"from": 0, "to": 1}}
    bounded = search_experiment(variables, population=10, stop={"iterations": 7})
    assert most_trials(bounded, ()) == 70 + 6 * 5
    stagnating = search_experiment(variables, population=10, stop={"iterations": 7, "stagnation": 3})
    assert most_trials(stagnating, ()) == 70 + 6 * 5
    restarted = search_experiment(variables, population=10, restarts=1, stop={"iterations": 7, "trials": 100})
    assert most_trials(restarted, ()) == 100 + 6 * 5


def test_the_plan_of_a_sweep_counts_every_trial_the_run_has(write, dry_run):
    path = write("sweep", extra="[trial.reference]\nevery = 5\ncondition = { a = 30, f = 1.2 }\n")
    plan = check(load_experiment(path))
    assert plan.trials == plan.trials_at_most == 12 + 3 + 3 * 3 == dry_run(path).done


def test_more_leaders_than_conditions_are_noticed(write):
    path = write("sweep")
    path.write_text(path.read_text().replace("count = 2", "count = 99999"))
    plan = check(load_experiment(path))
    assert plan.trials == 12 + 7 * 3
    assert any("leaders.count = 99999" in note for note in plan.notes)


def test_the_time_of_a_plan_ranges_from_the_least_settling_to_its_timeout(write):
    path = write("sweep")
    quiet = '{ until = "quiet", hold_s = 2, timeout_s = 50 }'
    path.write_text(path.read_text().replace('{ until = "time", hold_s = 1 }', quiet))
    plan = check(load_experiment(path))
    assert (plan.settle_s, plan.settle_at_most_s) == (4.0, 50.0)
    assert plan.time_at_most_s - plan.time_s == pytest.approx(plan.trials * 46.0)


def test_an_actuator_without_limits_is_noticed(write, tmp_path):
    loaded = load_experiment(write("sweep"), ["rig.devices.tail.limits={}"])
    plan = check(loaded)
    assert any(note.startswith("tail has no limit set") for note in plan.notes)
    assert plan_text(plan, tmp_path).count("no limit set") == 3


def test_the_plan_of_a_search_says_how_much_of_its_space_may_run(write, tmp_path):
    plan = check(load_experiment(write("cmaes"), ["cmaes.where=['a <= 35']"]))
    assert plan.space.share == pytest.approx(0.5, abs=0.01)
    assert plan.peaks[0].angle_deg == pytest.approx((-35, 35), abs=0.5)
    text = plan_text(plan, tmp_path)
    assert "about 50 % of the search space may run" in text
    assert "stay inside" not in text
    assert plan.report()["search_space"]["share"] == plan.space.share


def test_a_bound_that_a_linked_parameter_breaks_is_named_in_the_plan_of_a_search(write):
    linked = ['gait.joints.tail.amplitude_deg="-2*a"', 'cmaes.where=["a <= 60"]']
    plan = check(load_experiment(write("cmaes"), linked))
    angles = [item for item in plan.space.breaks if item.what.startswith("angle of tail")]
    assert plan.space.share < 0.45
    assert sum(item.share for item in angles) == pytest.approx(0.6, abs=0.02)  # a above 30 of 10 to 60
    assert "60 deg, at worst" in angles[0].what


def test_a_search_that_starts_outside_a_limit_says_so(write, tmp_path):
    loaded = load_experiment(write("cmaes"), ["rig.devices.tail.limits.angle_deg=[-30, 30]"])
    plan = check(loaded)
    assert any("angle of tail" in text for text in plan.space.start)
    assert "the search starts where it may not run" in plan_text(plan, tmp_path)
    plan.require_feasible()


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("rig.devices.tail.limits.angle_deg=[-1, 1]", "angle of tail"),
        ('cmaes.where=["a > 100"]', "100 % break: a > 100"),
    ],
)
def test_a_search_of_which_nothing_may_run_is_refused_before_a_folder_is_made(
    write, tmp_path, override, says
):
    loaded = load_experiment(write("cmaes"), [override])
    for attempt in (
        lambda: check(loaded),
        lambda: execute(loaded, results=tmp_path / "r", dry_run=True, draw=False),
    ):
        with pytest.raises(PlanError, match="nothing of the search space may run") as caught:
            attempt()
        assert says in str(caught.value)
        assert "resume" not in str(caught.value)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(("kind", "values"), [("sweep", "a = 30"), ("cmaes", "a = 10")])
def test_a_constraint_that_is_not_a_number_somewhere_is_told_with_its_place_and_the_values(
    write, tmp_path, kind, values
):
    path = write(kind)
    text = path.read_text()
    bad = 'where = ["a > 0", "sqrt(a - 40) >= 0"]\n'
    text = text.replace('where = ["a * f <= 70"]\n', bad) if kind == "cmaes" else text + bad
    path.write_text(text)
    line = text[: text.index("sqrt")].count("\n") + 1
    loaded = load_experiment(path)
    with pytest.raises(SpecError) as caught:
        execute(loaded, results=tmp_path / "r", dry_run=True, draw=False)
    assert f"{path}:{line}:" in str(caught.value)
    assert f"{kind}.where[1]" in str(caught.value)
    assert values in str(caught.value)
    assert not (tmp_path / "r").exists()


def test_a_plan_that_does_not_fit_on_the_disk_is_refused(write, monkeypatch, tmp_path):
    plan = check(write("sweep"))
    require_room(plan, tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_080))
    with pytest.raises(PlanError, match=r"1\.08 kB are free on the disk of"):
        require_room(plan, tmp_path / "not" / "made")
