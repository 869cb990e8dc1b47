"""An optimum at the end of its range says so, and whether there is room beyond."""

import pytest
from analytic_bench import GAIT, RIG, search_experiment
from hypothesis import given
from hypothesis import strategies as st

from labrun.devices import Excess
from labrun.experiment import Experiment
from labrun.search import Best, RunResult, range_end_notes

WIDER = "a wider range may hold a better one"


def sweep_experiment(axes, where=(), **sweep):
    return Experiment.model_validate(
        {
            "title": "analytic",
            "kind": "sweep",
            "rig": RIG,
            "gait": GAIT,
            "trial": {"duration_s": 1},
            "sweep": {"axes": axes, "where": list(where), **sweep},
        }
    )


def no_excess(condition):
    return []


SPEED = {"f": {"from": 0.2, "to": 1.5}, "a": {"from": 10.0, "to": 60.0}}


@pytest.mark.parametrize(
    ("best", "notes"),
    [
        ({"f": 1.499, "a": 30.0}, (f"at the upper end of f: {WIDER}",)),
        ({"f": 0.2, "a": 30.0}, (f"at the lower end of f: {WIDER}",)),
        ({"f": 0.9, "a": 30.0}, ()),
        ({"f": 1.5, "a": 10.1}, (f"at the upper end of f: {WIDER}", f"at the lower end of a: {WIDER}")),
    ],
)
def test_a_search_names_every_variable_at_whose_end_its_best_stands(best, notes):
    assert range_end_notes(search_experiment(SPEED), best, no_excess) == notes


def test_a_constraint_that_leaves_no_room_beyond_the_end_is_named():
    grid = sweep_experiment({"a": {"from": 10, "to": 60, "step": 5}}, ["a <= 60"])
    searched = search_experiment(SPEED, where=["a <= 60"])
    for experiment in (grid, searched):
        notes = range_end_notes(experiment, {"a": 60.0, "f": 1.0}, no_excess)
        assert notes == ("at the upper end of a: nothing beyond it may run: a <= 60",)


def test_a_limit_of_the_rig_that_leaves_no_room_beyond_the_end_is_named():
    def excess_of(condition):
        angle = condition["a"]
        return [Excess("angle of tail", angle, 60.0, "deg", 0.3)] if angle > 60 else []

    axes = {"a": {"from": 10, "to": 60, "step": 5}}
    (note,) = range_end_notes(sweep_experiment(axes), {"a": 60.0}, excess_of)
    assert note == (
        "at the upper end of a: nothing beyond it may run: angle of tail 65 deg is above the limit of 60 deg"
    )
    assert range_end_notes(sweep_experiment(axes), {"a": 10.0}, excess_of) == (
        f"at the lower end of a: {WIDER}",
    )


def test_a_value_beyond_the_end_that_cannot_be_computed_leaves_no_room():
    axes = {"a": [0.0, 1.0, 2.0]}
    (note,) = range_end_notes(sweep_experiment(axes, ["sqrt(a) >= 0"]), {"a": 0.0}, no_excess)
    assert note.startswith("at the lower end of a: nothing beyond it may run:")


def test_words_and_two_alternatives_have_no_range():
    axes = {"fin": ["soft", "stiff", "none"], "beams": [1, 2], "f": [0.7, 1.0, 1.4]}
    best = {"fin": "none", "beams": 2.0, "f": 1.0}
    assert range_end_notes(sweep_experiment(axes), best, no_excess) == ()


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=9, unique=True), st.data())
def test_of_a_list_in_any_order_only_the_least_and_greatest_are_ends(values, data):
    best = data.draw(st.sampled_from(values))
    notes = range_end_notes(sweep_experiment({"a": values}), {"a": best}, no_excess)
    near = 0.01 * (max(values) - min(values))
    assert (len(notes) > 0) == (min(abs(best - min(values)), abs(best - max(values))) <= near)


def test_terminal_and_json_say_it_and_a_stored_result_keeps_it(tmp_path):
    best = Best(
        {"f": 1.5}, "thrust", 3.225, (3.2, 3.25), "1", 3.3, 5, range_ends=(f"at the upper end of f: {WIDER}",)
    )
    result = RunResult(tmp_path, 9, 0, 0, best, None, finished=True)
    assert f"          at the upper end of f: {WIDER}" in result.to_text().splitlines()
    assert result.to_json()["best"]["range_ends"] == [f"at the upper end of f: {WIDER}"]
    assert Best.from_record(best.to_record()) == best


def test_a_number_without_dimension_is_shown_without_unit(tmp_path):
    best = Best({"f": 1.5}, "ratio", 3.225, (3.2, 3.25), "1", 3.3, 5, truncation=0.01)
    winners = (best, best)
    text = RunResult(tmp_path, 9, 0, 0, best, None, finished=True, winners=winners).to_text()
    assert "ratio = 3.225 (" in text
    assert "3.225 1" not in text
    assert "3.3 1" not in text
    assert "0.01 1" not in text
