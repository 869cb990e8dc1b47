"""A long search tells how far it is, and ends with its best answer so far."""

import threading

import numpy as np
import pytest

from labrun.fit import one_by_one, workers
from labrun.gap import Diagnosis, Options, diagnose_dataset
from labrun.gap.progress import Progress, TimeOver

from .benches import CONDITIONS, among, dry_friction, pendulum, recorded

FEW = among("coulomb-friction", "quadratic-drag", "lag")


def diagnosed(stop_at: str = "", **more: float) -> Diagnosis:
    """Return a diagnosis, interrupted at the first note that contains some words.

    The pendulum rubs, and more than that differs: the search goes on beside the friction.
    """

    def note(text: str) -> None:
        if stop_at and stop_at in text:
            raise KeyboardInterrupt

    rub = dry_friction(0.009)
    data = recorded(
        lambda t, q, v: rub(t, q, v) + 0.004 * float(np.sin(9.0 * q)), conditions=CONDITIONS[:3], repeats=1
    )
    return diagnose_dataset(data, pendulum(), Options(places=False, withhold=FEW.withhold, **more), note=note)


def test_every_item_is_worked_on_and_how_many_there_are_is_told() -> None:
    notes: list[str] = []
    progress = Progress(one_by_one, notes.append)
    assert progress("fitting", lambda number: number**2, range(4)) == [0, 1, 4, 9]
    assert notes[0] == "fitting: 0 of 4"


def test_after_the_deadline_nothing_is_started() -> None:
    started: list[int] = []
    progress = Progress(one_by_one, lambda _: None, deadline_s=0.0)
    with pytest.raises(TimeOver):
        progress("fitting", started.append, range(4))
    assert started == []


def test_workers_in_parallel_stop_at_the_deadline_too() -> None:
    lock, started = threading.Lock(), 0

    def count(_: int) -> None:
        nonlocal started
        with lock:
            started += 1

    with workers(2) as each, pytest.raises(TimeOver):
        Progress(each, lambda _: None, deadline_s=0.0)("fitting", count, range(50))
    assert started == 0


def test_a_search_without_time_gives_the_recalibrated_model_and_says_that_it_is_not_complete() -> None:
    diagnosis = diagnosed(within_s=0.0)
    assert diagnosis.stopped == "time"
    assert not diagnosis.complete
    assert diagnosis.causes == ()
    assert [rung.step for rung in diagnosis.ladder] == ["as stated", "recalibrated"]
    answer = diagnosis.to_json()
    assert (answer["complete"], answer["stopped"]) == (False, "time")
    assert "longer --within" in answer["what_next"][0]


def test_an_interrupted_search_keeps_the_cause_that_it_has_found() -> None:
    diagnosis = diagnosed(stop_at="beside coulomb-friction at hinge")
    assert diagnosis.stopped == "interrupted"
    assert [str(cause.name) for cause in diagnosis.causes] == ["coulomb-friction at hinge"]
    assert diagnosis.causes[0].values["torque"].value == pytest.approx(0.009, rel=0.2)


def test_an_interruption_before_there_is_an_answer_ends_the_diagnosis() -> None:
    with pytest.raises(KeyboardInterrupt):
        diagnosed(stop_at="trying")
