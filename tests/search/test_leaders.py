import numpy as np
import pytest
from analytic_bench import AnalyticBench

from labrun.experiment import Leaders
from labrun.runner import Measurement
from labrun.search import honest_best, leading_conditions
from labrun.store import TrialOutcome


def best_of(bench, count, goal="maximise", leaders=None):
    result = bench.measure([{"k": float(k)} for k in range(count)])
    return honest_best(
        bench, result, objective="thrust", goal=goal, unit="N", leaders=leaders or Leaders(count=5, repeats=5)
    )


def test_the_interval_covers_the_truth_95_percent_of_the_time_while_the_luckiest_is_biased():
    def truth(condition):
        return 0.02 * condition["k"]

    runs = 1000
    covered, errors, lucky_errors = 0, [], []
    for seed in range(runs):
        best = best_of(AnalyticBench(truth, noise=1.0, seed=seed), 40)
        value = truth(best.parameters)
        covered += best.ci95[0] <= value <= best.ci95[1]
        errors.append(best.value - value)
        lucky_errors.append(best.luckiest - value)
    assert covered / runs == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / runs))
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(runs)
    assert np.mean(lucky_errors) > 1.5


def test_the_value_comes_from_confirming_trials_alone():
    bench = AnalyticBench(lambda c: c["k"], noise=0.5, seed=3)
    best = best_of(bench, 10)
    confirming = [o.objectives["thrust"] for o in bench.stored.values() if o.role == "confirm"]
    assert len(confirming) == 5
    assert best.value == pytest.approx(np.mean(confirming))
    assert best.trials == 5
    fresh = [o for o in bench.stored.values() if o.role == "fresh"]
    assert len(fresh) == 25
    assert best.luckiest == max(o.objectives["thrust"] for o in bench.stored.values())


def test_a_minimum_is_found_as_well():
    best = best_of(AnalyticBench(lambda c: (c["k"] - 6) ** 2, noise=0.1), 12, goal="minimise")
    assert best.parameters == {"k": 6.0}
    assert best.luckiest <= best.value


def measured(condition, values, status="done"):
    outcomes = [
        TrialOutcome(i, condition, i, status=status, objectives={"thrust": v}) for i, v in enumerate(values)
    ]
    return Measurement(condition, "measure", tuple(outcomes))


def leading(result, goal, count=None):
    values = ((entry.condition, entry.values("thrust"), entry.truncation("thrust")) for entry in result)
    return leading_conditions(values, goal, count)


def test_what_a_cut_may_have_added_makes_nothing_lead():
    flattered = TrialOutcome(
        1, {"k": 1.0}, 1, status="done", objectives={"thrust": 0.30}, truncation={"thrust": 0.1}
    )
    whole = TrialOutcome(2, {"k": 2.0}, 2, status="done", objectives={"thrust": 0.25})
    measurements = [Measurement(outcome.condition, "measure", (outcome,)) for outcome in (flattered, whole)]
    assert [entry["k"] for entry in leading(measurements, "maximise")] == [2.0, 1.0]
    assert [entry["k"] for entry in leading(measurements, "minimise")] == [2.0, 1.0]


def test_a_condition_measured_once_does_not_lead_by_luck():
    rng = np.random.default_rng(0)
    results = [measured({"k": float(k)}, rng.normal(k, 2.0, 10)) for k in range(6)]
    lucky = measured({"k": 99.0}, [6.0])
    best = max(m.mean("thrust") for m in results)
    assert lucky.mean("thrust") > best
    assert leading([*results, lucky], "maximise", 1) != [{"k": 99.0}]


def test_measurements_of_one_condition_are_pooled_and_it_leads_once():
    results = [measured({"k": 1.0}, [3.0, 3.2]), measured({"k": 2.0}, [1.0]), measured({"k": 1.0}, [2.9])]
    assert leading(results, "maximise", 5) == [{"k": 1.0}, {"k": 2.0}]


def test_without_an_accepted_trial_there_is_no_best():
    results = [measured({"k": 1.0}, [3.0], status="rejected")]
    bench = AnalyticBench(lambda c: 0.0)
    rule = Leaders(count=2, repeats=2)
    assert honest_best(bench, results, objective="thrust", goal="maximise", unit="N", leaders=rule) is None
    assert bench.ran == 0
