"""Specimens set by hand: blocks, questions, a wrong mounting taken back, stopping and going on."""

import pytest

from labrun.errors import ExperimentError
from labrun.runner import LimitReached, Scripted, Session, worn_before
from labrun.store import RunFolder, open_run

CONDITIONS = [{"a": a, "f": 1.0, "specimen": s} for a in (10.0, 20.0) for s in ("p1", "p2")]
BY_HAND = {"names": ["specimen"], "ask": "Mount {specimen}", "mountings": 2}
AXES = {"a": [10, 20], "f": [1.0], "specimen": ["p1", "p2"]}


class AtTheBench:
    """Answers from a list, "" once it is used up; remembers what it was asked."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    def __call__(self, text):
        self.asked.append(text)
        return self.answers.pop(0) if self.answers else ""


@pytest.fixture
def bench(lab):
    """Return a function that makes a session whose specimens somebody mounts."""

    def make(person, *, folder=None, limit=None, worn=(), **changes):
        extra = {} if folder is None else {"folder": folder}
        made = lab(by_hand=BY_HAND, sweep__axes=AXES, **extra, **changes)
        made.session = Session(
            made.experiment,
            made.rig,
            made.folder,
            made.clock,
            1,
            limit=limit,
            person=Scripted(person),
            worn=worn,
        )
        return made

    return make


def blocks(session):
    """Return mounting and specimen of each run of trials."""
    results = []
    for outcome in session.outcomes:
        entry = (outcome.mounting, outcome.condition["specimen"])
        if not results or results[-1] != entry:
            results.append(entry)
    return results


def test_a_person_is_asked_once_per_change_and_every_specimen_is_mounted_as_often_as_the_file_says(bench):
    person = AtTheBench()
    session = bench(person).session
    result = session.measure(CONDITIONS)
    assert [number for number, _ in blocks(session)] == [1, 2, 3, 4]
    assert sorted(specimen for _, specimen in blocks(session)) == ["p1", "p1", "p2", "p2"]
    assert [len(item.accepted) for item in result] == [4] * 4  # two repeats in each of two mountings
    assert len(person.asked) == 5
    assert person.asked[0].startswith(f"Mount {blocks(session)[0][1]} (mounting 1 of 4)")
    assert "All is measured" in person.asked[-1]


def test_a_specimen_mounted_twice_in_a_row_is_taken_out_in_between(bench):
    person = AtTheBench()
    bench(person).session.measure([CONDITIONS[0]])
    assert person.asked[1].startswith("Take it out and mount it again: Mount p1 (mounting 2 of 2)")


def test_a_wrong_mounting_is_taken_back_measured_anew_and_kept(bench):
    person = AtTheBench("", "", "back")
    session = bench(person).session
    result = session.measure(CONDITIONS, order="as-listed")
    assert blocks(session) == [(1, "p1"), (2, "p2"), (3, "p2"), (4, "p1"), (5, "p2")]
    taken_back = [outcome for outcome in session.outcomes if outcome.mounting == 2]
    assert [outcome.status for outcome in taken_back] == ["rejected"] * 4
    assert taken_back[0].reason == "set aside: mounting 2 was taken back"
    assert [len(item.accepted) for item in result] == [4] * 4
    assert "Mount p2 (mounting 3 of 5)" in person.asked[3]


def test_even_the_last_mounting_and_any_one_by_its_number_can_be_taken_back(bench):
    person = AtTheBench("", "", "", "", "back 1", "", "")
    session = bench(person).session
    session.measure(CONDITIONS, order="as-listed")
    assert blocks(session)[-1] == (5, "p1")
    assert {o.status for o in session.outcomes if o.mounting == 1} == {"rejected"}


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        ("back", "no earlier mounting can be taken back"),
        ("p7", "'p7' is not an answer"),
        ("back 9", "unknown mounting 9; mountings so far: 1"),
    ],
)
def test_an_answer_that_cannot_be_meant_is_asked_again_with_the_reason(bench, answer, complaint):
    person = AtTheBench(*([] if answer in ("back", "p7") else [""]), answer)
    bench(person).session.measure(CONDITIONS)
    assert any(text.startswith(complaint) for text in person.asked)


def test_a_script_that_never_gives_an_answer_ends_the_run(bench):
    with pytest.raises(ExperimentError, match="after 10 attempts"):
        bench(lambda text: "what?").session.measure(CONDITIONS)


@pytest.mark.parametrize("limit", [1, 5, 6, 9])
def test_stopping_and_going_on_loses_nothing_and_asks_nothing_twice(bench, tmp_path, limit):
    answers = ["", "", "back", "", ""]
    whole = bench(AtTheBench(*answers)).session
    whole.measure(CONDITIONS, order="as-listed")
    folder = RunFolder.create(tmp_path / "other", "paddle", "title = 'x'", {"seed": 1})
    first = AtTheBench(*answers)
    with pytest.raises(LimitReached):
        bench(first, folder=folder, limit=limit).session.measure(CONDITIONS, order="as-listed")
    second = AtTheBench("", *first.answers)  # the first question is whether all is as it was left
    again = bench(second, folder=RunFolder.open(folder.path)).session
    again.measure(CONDITIONS, order="as-listed")
    assert "was in place when the run stopped" in second.asked[0]
    assert not any("stopped" in text for text in second.asked[1:])
    assert [(o.mounting, o.condition, o.status, o.objectives) for o in again.outcomes] == [
        (o.mounting, o.condition, o.status, o.objectives) for o in whole.outcomes
    ]


def test_what_was_taken_out_while_the_run_stood_still_is_mounted_and_measured_anew(bench):
    lab = bench(AtTheBench(), limit=6)
    with pytest.raises(LimitReached):
        lab.session.measure(CONDITIONS, order="as-listed")
    for person in (AtTheBench("again"), AtTheBench()):  # the second time, the answer is replayed
        session = bench(person, folder=RunFolder.open(lab.folder.path)).session
        session.measure(CONDITIONS, order="as-listed")
        assert blocks(session) == [(1, "p1"), (2, "p2"), (3, "p2"), (4, "p1"), (5, "p2")]
        assert {o.status for o in session.outcomes if o.mounting == 2} == {"rejected"}
    assert len(person.asked) == 1  # only whether all were right: nothing was left to measure


PAST = {"when": "a >= 20", "allow_damage": True}


def test_trials_that_damage_come_last_on_each_specimen_and_once(bench):
    session = bench(AtTheBench(), damage=PAST).session
    result = session.measure(CONDITIONS)
    for specimen in ("p1", "p2"):
        there = [outcome for outcome in session.outcomes if outcome.condition["specimen"] == specimen]
        assert [outcome.condition["a"] for outcome in there] == [10.0] * 4 + [20.0]
        assert [outcome.damage for outcome in there] == [""] * 4 + ["past its limit"]
    assert [len(item.accepted) for item in result] == [4, 4, 1, 1]


def test_a_broken_specimen_is_neither_measured_nor_mounted_again(bench):
    person = AtTheBench()
    fragile = {"broken": "thrust > 0 and specimen == 'p1'"}
    lab = bench(person, damage=fragile)
    lab.session.measure(CONDITIONS, order="as-listed")
    assert blocks(lab.session) == [(1, "p1"), (2, "p2"), (3, "p2")]
    assert [outcome.damage for outcome in lab.session.outcomes] == ["broken"] + [""] * 8
    assert sum("Mount p1" in text for text in person.asked) == 1
    with open_run(lab.folder.path) as run:
        assert run.outcomes[0].damage == "broken"
    again = bench(
        AtTheBench(),
        folder=RunFolder.open(lab.folder.path),
        damage={"broken": "thrust > 0 and specimen == 'p1'"},
    )
    again.session.measure(CONDITIONS, order="as-listed")
    assert again.session.new_trials == 0


def test_taking_a_mounting_back_takes_back_what_it_did_to_its_specimen(bench):
    session = bench(AtTheBench("", "back"), damage={"broken": "a == 10 and specimen == 'p1'"}).session
    session.measure(CONDITIONS, order="as-listed")
    assert blocks(session)[:2] == [(1, "p1"), (2, "p1")]


def test_without_specimens_the_bench_is_the_one(lab):
    session = lab(damage=PAST).session
    result = session.measure([{"a": 20, "f": 1.0}, {"a": 10, "f": 1.0}, {"a": 30, "f": 1.0}])
    assert [len(item.accepted) for item in result] in ([1, 2, 0], [0, 2, 1])


def test_what_an_earlier_run_broke_is_neither_mounted_nor_measured_in_the_next(bench, tmp_path):
    def new(name):
        return RunFolder.create(tmp_path / name, "paddle", 'title = "paddle"\n', {"seed": 1})

    fragile = {"broken": "thrust > 0 and specimen == 'p1'"}
    first = bench(AtTheBench(), damage=fragile)
    first.session.measure(CONDITIONS, order="as-listed")
    worn = worn_before([first.folder.path], first.experiment.damage, first.experiment.by_hand)
    assert [(dict(other.specimen), other.damage) for other in worn] == [({"specimen": "p1"}, "broken")]
    assert worn[0].by.startswith("trial 0 of ")

    person = AtTheBench()
    second = bench(person, damage=fragile, worn=worn, folder=new("second")).session
    second.measure(CONDITIONS, order="as-listed")
    assert blocks(second) == [(1, "p2"), (2, "p2")]
    assert not any("Mount p1" in text for text in person.asked)

    with pytest.raises(
        ExperimentError, match=r"p1 is broken since trial 0 of .*nothing is measured on it"
    ) as raises:
        third = bench(AtTheBench(), damage=fragile, worn=worn, folder=new("third")).session
        third.measure(CONDITIONS[::2])
    assert "damage.fresh=true" in raises.value.hint
