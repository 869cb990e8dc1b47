"""A search for every level of a factor, and the winners compared."""

import io

import pytest
from rich.console import Console

import labrun
from labrun.app.report import opened
from labrun.app.resume import resume
from labrun.app.run import run as execute
from labrun.experiment import load_experiment
from labrun.report.terminal import print_findings
from labrun.search import Best, stored_result
from labrun.search.result import winner_lines
from labrun.store import open_run

EACH = '[cmaes.each]\nfin = ["large", "small"]\n[cmaes.variables]'
BY_HAND = '[by_hand]\nnames = ["fin"]\n[cmaes]'


@pytest.fixture
def each(write):
    path = write("cmaes")
    path.write_text(path.read_text().replace("[cmaes.variables]", EACH).replace("[cmaes]", BY_HAND))
    return path


@pytest.fixture
def whole(each, dry_run):
    return dry_run(each)


def test_what_is_shown_of_the_run_later_tells_how_its_searches_ended(whole):
    text = io.StringIO()
    with opened(whole.run) as result:
        print_findings(result, Console(file=text, width=400))
        shown = result.to_json()
    for line in whole.search_lines():
        assert line in text.getvalue()
    assert len(shown["search"]) == len(shown["winners"]) == 2


def test_the_plan_counts_a_mounting_for_each_level(each):
    assert any(note.startswith("2 mountings of fin by hand") for note in labrun.check(each).notes)


def test_every_level_has_a_search_a_winner_and_a_verdict_of_its_own(whole):
    assert {best.parameters["fin"] for best in whole.winners} == {"large", "small"}
    assert whole.best == whole.winners[0]
    assert whole.winners[0].value >= whole.winners[1].value
    assert [verdict.level["fin"] for verdict in whole.verdicts] == ["large", "small"]
    assert all(verdict.ending == "budget spent" for verdict in whole.verdicts)
    assert stored_result(whole.run).winners == whole.winners
    assert stored_result(whole.run).verdicts == whole.verdicts
    with open_run(whole.run) as run:
        order = [str(outcome.condition["fin"]) for outcome in run.outcomes]
    assert order == sorted(order)


def test_stopped_and_resumed_it_ends_as_in_one_go(each, whole, dry_run):
    part = dry_run(each, limit=60, results="parts")
    ended = resume(part.run)
    assert ended.winners == whole.winners
    assert ended.verdicts == whole.verdicts


def test_a_person_mounts_each_level_once(each, tmp_path, recorder):
    asked = []
    execute(
        load_experiment(each),
        results=tmp_path / "r",
        dry_run=True,
        seed=5,
        progress=recorder,
        draw=False,
        person=lambda text: asked.append(text) or "",
    )
    assert len(asked) == 2
    assert "large" in asked[0]
    assert "small" in asked[1]


def winner(level, value, ci95):
    return Best({"m": level, "a": 1.0}, "thrust", value, ci95, "N", value, 4)


@pytest.mark.parametrize(
    ("interval", "words"), [((1.0, 2.0), "not distinguishable from m = b"), ((0.1, 0.3), "stands apart")]
)
def test_winners_whose_intervals_overlap_are_not_told_apart(interval, words):
    lines = winner_lines([winner("a", 3.0, (1.9, 4.1)), winner("b", 1.0, interval)], [{"m": "a"}, {"m": "b"}])
    assert words in lines[-1]
