"""Results in a notebook."""

import base64
from importlib import import_module
from pathlib import Path

import pytest

import labrun
from labrun.gap import FreshTest, UnitComparison
from labrun.gap.next import Proposal, TrialPlan
from labrun.notebook import as_html
from labrun.report import fresh_text, plan_text, ranking_text, trial_plan_text, units_text
from labrun.search import Ranking, RunResult


def test_a_result_shows_its_text_and_its_picture(tmp_path):
    figure = tmp_path / "figure.png"
    figure.write_bytes(b"pixels")
    result = RunResult(tmp_path, done=3, rejected=1, failed=0, best=None, figure=figure, finished=True)
    shown = result._repr_html_()
    assert "3 done, 1 rejected, 0 failed" in shown
    assert base64.b64encode(b"pixels").decode() in shown


def test_what_a_result_tells_never_becomes_markup(tmp_path):
    assert as_html("<b>odd", tmp_path / "gone.png") == "<div><pre>&lt;b&gt;odd</pre></div>"


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (FreshTest("swing", "", "bench", 2, 25, (), ("Of two trials.",)), fresh_text),
        (UnitComparison("one", "other", "swing", (2, 2), (), None, ("Of two trials.",)), units_text),
        (TrialPlan(None, "swing", (), 3, 0.0, (), {}, 0, ("Of two trials.",)), trial_plan_text),
        (
            Proposal("cannot", None, ("one", "other"), (None, None), False, "", (), 3, 0.0, 0.0, ()),
            Proposal.to_text,
        ),
        (
            Ranking("field", ("tank",), "thrust", "N", True, (), {"tank": ()}, (), None, ("Of none.",)),
            ranking_text,
        ),
    ],
    ids=lambda entry: type(entry).__name__,
)
def test_what_a_command_prints_is_what_a_notebook_shows(result, words):
    import_module("labrun.app")  # as every command and every function of the API does
    assert result._repr_html_() == as_html(words(result))


def test_a_plan_and_a_run_show_themselves(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plan = labrun.check("hinge", dry_run=True)
    assert plan._repr_html_() == as_html(plan_text(plan, Path("results")))
    assert "labrun run of table-7-2" in labrun.open("table-7-2")._repr_html_()


def test_the_doctor_returns_what_it_found():
    remarks = labrun.doctor()
    assert remarks
    assert remarks == tuple(remarks)
