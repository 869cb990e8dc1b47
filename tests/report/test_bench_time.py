"""Where the bench's time went."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.report.timing import bench_time
from labrun.store import SettleSummary, TrialOutcome

DURATION = st.floats(min_value=0.0, max_value=500.0)


def events_and_outcomes(trials, *, start_s=50.0, between=()):
    """Return journal and outcomes of trials given as (move, settle, tare, record, safe pose, store) in s."""
    clock, events, outcomes = start_s, [], []
    for index, (move, settle, tare, record, safe, store) in enumerate(trials):
        events += [dict(event) for number, event in between if number == index]
        events.append({"event": "prepare", "index": index, "clock_s": clock})
        clock += move + settle + tare
        events.append({"event": "record", "index": index, "clock_s": clock})
        clock += record
        events.append({"event": "safe-pose", "index": index, "clock_s": clock})
        clock += safe
        outcomes.append(
            TrialOutcome(
                index, {}, 0, settle=SettleSummary("quiet", settle), tare={"wrench.force_x": 0.0},
                checkpoint=json.dumps({"clock_s": clock}),
            )
        )  # fmt: skip
        clock += store
    return events, outcomes


@given(
    st.lists(
        st.tuples(DURATION, DURATION, st.just(1.0), DURATION, DURATION, DURATION), min_size=1, max_size=6
    )
)
def test_every_step_gets_the_time_that_it_took(trials):
    times = bench_time(*events_and_outcomes(trials), tare_s=1.0)
    assert times is not None
    for number, step in enumerate(("move", "settle", "tare", "record", "safe pose")):
        assert times.of(step) == pytest.approx(sum(trial[number] for trial in trials), abs=1e-6)
    assert times.of("store") == pytest.approx(sum(trial[5] for trial in trials[:-1]), abs=1e-6)


def test_the_pause_of_an_interrupted_run_is_not_bench_time():
    trials = [(1.0, 5.0, 1.0, 4.0, 1.0, 3600.0), (1.0, 5.0, 1.0, 4.0, 1.0, 0.0)]
    paused = events_and_outcomes(trials, between=[(1, {"event": "resumed", "changed": []})])
    times = bench_time(*paused, tare_s=1.0)
    assert times is not None
    assert times.total_s == pytest.approx(24.0)


def test_a_trial_that_was_run_again_counts_as_it_was_run_last():
    events, outcomes = events_and_outcomes([(1.0, 5.0, 1.0, 4.0, 1.0, 0.0)])
    times = bench_time([{"event": "prepare", "index": 0, "clock_s": 0.0}, *events], outcomes, tare_s=1.0)
    assert times is not None
    assert times.total_s == pytest.approx(12.0)


def test_a_trial_that_never_came_to_rest_spent_its_time_settling():
    outcome = TrialOutcome(
        0, {}, 0, status="rejected", settle=SettleSummary("timeout", 60.0), checkpoint='{"clock_s": 63.0}'
    )
    times = bench_time([{"event": "prepare", "index": 0, "clock_s": 0.0}], [outcome], tare_s=1.0)
    assert times is not None
    assert times.steps == {"move": [3.0], "settle": [60.0]}


def test_a_journal_without_times_tells_nothing():
    assert bench_time([{"event": "created"}], [TrialOutcome(0, {}, 0)], tare_s=0.0) is None
