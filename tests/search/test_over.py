"""A candidate measured at several settings counts as one."""

import numpy as np
import pytest
from analytic_bench import AnalyticBench

from labrun.app.check import check
from labrun.app.report import confirmed_best, read_findings
from labrun.errors import SpecError
from labrun.experiment import Leaders, RepeatRule, load_experiment
from labrun.search import OverSettings, at_settings, honest_best, settings_of, stored_result
from labrun.store import open_run

OVER = """
[sweep]
axes = { a = [20, 40] }
over = { f = [0.8, 1.2] }
combine = "sum"
"""
TWO = RepeatRule(min=2, max=2)
SETTINGS = [{"v": 1.0}, {"v": 3.0}]


def measures(truth, combine, goal="maximise", noise=0.0):
    return OverSettings(AnalyticBench(truth, noise=noise, repeats=TWO), SETTINGS, combine, goal)


@pytest.mark.parametrize(
    ("combine", "goal", "value"),
    [
        ("sum", "maximise", 4.0),
        ("mean", "maximise", 2.0),
        ("worst", "maximise", 1.0),
        ("worst", "minimise", 3.0),
    ],
)
def test_values_at_all_settings_become_one(combine, goal, value):
    (result,) = measures(lambda c: c["k"] * c["v"], combine, goal).measure([{"k": 1.0}])
    assert result.condition == {"k": 1.0}
    assert result.values("thrust") == pytest.approx([value, value])
    assert len(result.outcomes) == 4


def test_the_leader_is_the_best_over_all_settings_and_not_at_one():
    session = measures(lambda c: 10.0 if c["k"] == 1 and c["v"] == 1 else c["k"], "worst")
    result = session.measure([{"k": 1.0}, {"k": 2.0}])
    best = honest_best(
        session, result, objective="thrust", goal="maximise", unit="N", leaders=Leaders(count=2, repeats=3)
    )
    assert best.parameters == {"k": 2.0}
    assert best.value == 2.0
    assert best.trials == 3


def test_the_interval_of_a_sum_covers_the_sum():
    covered = 0
    for seed in range(300):
        bench = AnalyticBench(
            lambda c: c["k"] * c["v"], noise=0.5, seed=seed, repeats=RepeatRule(min=5, max=5)
        )
        session = OverSettings(bench, SETTINGS, "sum", "maximise")
        result = session.measure([{"k": 2.0}])
        best = honest_best(
            session,
            result,
            objective="thrust",
            goal="maximise",
            unit="N",
            leaders=Leaders(count=1, repeats=5),
        )
        covered += best.ci95[0] <= 8.0 <= best.ci95[1]
    assert covered / 300 == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 300))


def sweep(write, extra=OVER):
    path = write("sweep")
    path.write_text(path.read_text().partition("[sweep]")[0] + extra)
    return path


def test_a_sweep_measures_each_point_at_each_setting_and_names_the_best_point(write, dry_run):
    path = sweep(write)
    result = dry_run(path)
    assert set(result.best.parameters) == {"a"}
    with open_run(result.run) as run:
        measured = [o.condition for o in run.outcomes if o.role == "measure"]
        confirming = [o for o in run.outcomes if o.role == "confirm"]
    experiment = load_experiment(path).experiment
    expected = at_settings([{"a": 20.0}, {"a": 40.0}], settings_of(experiment)) * 2
    assert sorted(map(str, measured)) == sorted(map(str, expected))
    assert len(confirming) == 3 * 2
    plan = check(path)
    assert plan.trials == len(measured) + 2 * 3 * 2 + 3 * 2


def test_what_is_told_of_a_best_says_over_which_settings_it_is_summed_and_ranks_the_sums(write, dry_run):
    result = dry_run(sweep(write))
    assert "sum over f = 0.8, 1.2" in result.to_text()
    assert result.to_json()["best"]["combined"].startswith("sum over f")
    with open_run(result.run) as run:
        findings = read_findings(run)
        assert confirmed_best(findings).value == pytest.approx(result.best.value)
    rows = findings.conditions
    assert [row.condition["a"] for row in rows[:2]] == [result.best.parameters["a"]] * 2
    for pair in (rows[:2], rows[2:]):
        assert [row.condition["f"] for row in pair] == [0.8, 1.2]
        both = sum(row.points["thrust"].mean for row in pair)
        assert pair[0].combined.mean == pytest.approx(both)
    assert rows[0].combined.mean > rows[2].combined.mean


def test_a_search_over_settings_that_was_stopped_and_resumed_ends_as_one_in_one_go(write, dry_run):
    from labrun.app.resume import resume

    path = write("cmaes").rename(write("cmaes").with_name("over.toml"))
    text = path.read_text().replace(
        "[cmaes.variables]", '[cmaes.over]\nx = ["still", "moving"]\n[cmaes.variables]'
    )
    path.write_text(text.replace("[cmaes]", '[cmaes]\ncombine = "worst"'))
    whole = dry_run(path)
    part = dry_run(path, limit=13, results="parts")
    assert not part.finished
    ended = resume(part.run)
    assert ended.to_json()["best"] == whole.to_json()["best"]
    assert stored_result(part.run).best == whole.best


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (OVER.replace("f = [0.8, 1.2]", "a = [1, 2], f = [1]"), "is varied already"),
        (OVER.replace("0.8, 1.2", "1.2, 1.2"), "names a value twice"),
        (
            OVER.replace("over = { f = [0.8, 1.2] }", "").replace("a =", "f = [1], a ="),
            "nothing is there to combine",
        ),
    ],
)
def test_settings_that_do_not_hold_are_told_at_their_place(write, table, text):
    with pytest.raises(SpecError, match=text):
        load_experiment(sweep(write, table))
