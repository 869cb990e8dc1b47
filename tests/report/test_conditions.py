"""What each condition gave, in the terminal and for scripts."""

import io
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from memory_run import sweep_view
from rich.console import Console

from labrun.app.report import read_findings
from labrun.report.conditions import condition_results, conditions_context, in_order, most_promising
from labrun.report.figures.runs import condition_title
from labrun.report.terminal import print_conditions, print_findings
from labrun.store import open_run


def test_every_accepted_trial_but_references_counts_once_in_its_condition():
    view = sweep_view(lambda c: c["f"], {"f": [1, 2, 3]}, repeats=4)
    results = condition_results(view)
    assert [(r.condition["f"], r.accepted, r.best) for r in results] == [
        (1, 4, False),
        (2, 4, False),
        (3, 9, True),
    ]
    for result in results:
        mean = np.mean([trial.objectives["thrust"] for trial in result.trials])
        assert result.points["thrust"].mean == pytest.approx(mean)


def test_the_goal_puts_the_most_promising_first_and_what_has_no_value_last():
    view = sweep_view(lambda c: c["f"], {"f": [1, 2, 3, 4]})
    view.run.outcomes[:] = [
        replace(o, status="rejected", objectives={}) if o.condition["f"] == 2 else o
        for o in view.run.outcomes
    ]
    ranked = most_promising(view, condition_results(view))
    assert [result.condition["f"] for result in ranked] == [4, 3, 1, 2]


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_page_has_a_column_of_errors_only_where_something_was_repeated(repeats):
    view = sweep_view(lambda c: c["f"], {"f": [1, 2, 3]}, repeats=repeats)
    thrust = view.experiment.objectives["thrust"].model_copy(update={"goal": None})
    experiment = view.experiment.model_copy(update={"objectives": {"thrust": thrust}})
    view.run.outcomes[:] = [outcome for outcome in view.run.outcomes if outcome.role == "measure"]
    table = conditions_context(replace(view, experiment=experiment))["every"]["table"]
    assert ("standard error" in table.columns) == (repeats > 1)
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_numbers_are_ordered_as_numbers_and_words_as_words():
    view = sweep_view(lambda c: 0.0, {"f": [1]})
    ordered = in_order(view.experiment, [{"f": 10}, {"f": "soft"}, {"f": 9}, {"f": "hard"}])
    assert [condition["f"] for condition in ordered] == [9, 10, "hard", "soft"]


def test_a_value_without_dimension_has_no_unit_over_its_panel():
    view = sweep_view(lambda c: c["gain"], {"gain": [0.1, 0.2]}, units={"gain": "1"})
    assert condition_title(view, view.run.outcomes[0]).replace("\u00a0", " ") in ("gain = 0.1", "gain = 0.2")


def test_show_tells_which_controller_has_which_error(tracked):
    with open_run(tracked) as run:
        findings = read_findings(run)
        console = Console(file=io.StringIO(), width=80)
        print_findings(findings, console)
        rows = json.loads(json.dumps(findings.to_json()))["conditions"]
    text = console.file.getvalue()
    for objective in ("first_cycle (N)", "later (N)", "bias (N)"):
        assert objective in text
    assert len(rows) == len(findings.conditions)
    for row in rows:
        line = next(
            line for line in text.splitlines() if line.startswith(f" {row['condition']['controller']} ")
        )
        assert int(line.split()[1]) == row["accepted"]
        assert float(line.split()[2]) == pytest.approx(row["objectives"]["first_cycle"]["mean"], abs=6e-4)
        assert row["objectives"]["first_cycle"]["unit"] == "N"


def test_controllers_stand_in_the_order_of_the_file(tracked):
    with open_run(tracked) as run:
        shown = [result.condition["controller"] for result in read_findings(run).conditions]
    listed = ["P-100", "P-109", "P-120", "PI", "FF-P", "FF-PI"]
    assert shown == [name for name in listed if name in shown]


def test_a_narrow_terminal_shows_means_that_are_not_cut():
    names = [f"objective_{number}" for number in range(9)]
    view = sweep_view(lambda c: 0.1234 * c["f"], {"f": [1, 2]})
    units = dict.fromkeys(names, "N m")
    results = [
        replace(result, points=dict.fromkeys(names, result.points["thrust"]))
        for result in condition_results(view)
    ]
    console = Console(file=io.StringIO(), width=80)
    print_conditions(
        SimpleNamespace(
            conditions=results, objective_units=units, experiment=SimpleNamespace(goal=None, units={})
        ),
        console,
    )
    text = console.file.getvalue()
    assert "means (a wider terminal shows intervals)" in text
    assert "…" not in text
    assert text.count(f"{results[1].points[names[0]].mean:.3f}") == len(names)
