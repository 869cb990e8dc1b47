import json

import pytest
from analytic_bench import AnalyticBench, InterruptedBenchError, box, search_experiment

from labrun.devices import Excess
from labrun.errors import PlanError, StoreError
from labrun.experiment import RepeatRule
from labrun.runner import SilentProgress
from labrun.search import Constraint, Feasibility, read_generations, search_by_cmaes


def no_excess(condition):
    return []


def search(experiment, bench, folder, seed=1, limit_excesses=no_excess):
    return search_by_cmaes(
        experiment,
        bench,
        folder,
        feasibility=Feasibility(experiment.cmaes, limit_excesses),
        seed=seed,
        progress=SilentProgress(),
    )


def hill(condition):
    return 3.0 - ((condition["a"] - 4) / 5) ** 2 - ((condition["b"] + 3) / 8) ** 2


def test_the_search_finds_the_top_of_a_noisy_hill(tmp_path):
    experiment = search_experiment(box("ab"), repeats=3, reevaluate=3, stop={"iterations": 25})
    search(experiment, AnalyticBench(hill, noise=0.1, repeats=RepeatRule(min=3, max=3)), tmp_path)
    mean = read_generations(tmp_path)[-1]["mean_condition"]
    assert mean["a"] == pytest.approx(4, abs=1)
    assert mean["b"] == pytest.approx(-3, abs=1.5)


def test_a_minimised_objective_is_minimised(tmp_path):
    experiment = search_experiment(box("ab"), goal="minimise", stop={"iterations": 25})
    search(experiment, AnalyticBench(lambda c: -hill(c)), tmp_path)
    best = read_generations(tmp_path)[-1]["best"]
    assert best["value"] == pytest.approx(-3, abs=0.01)


def test_the_search_is_herded_into_the_feasible_region_and_nothing_infeasible_ever_ran(tmp_path):
    # Feasible: a corner of the space, far from the start and from the unconstrained optimum.
    where = ["a + b <= -9", "b >= -9"]
    variables = {"a": {"from": -10, "to": 10, "initial": 5}, "b": {"from": -10, "to": 10, "initial": 5}}
    experiment = search_experiment(variables, population=12, where=where, stop={"iterations": 40})
    bench = AnalyticBench(hill, noise=0.02)
    search(experiment, bench, tmp_path)
    shares = [state["feasible_share"] for state in read_generations(tmp_path)]
    assert shares[0] < 0.2
    assert sum(shares[-10:]) / 10 > 0.4
    assert bench.conditions_seen
    assert all(Constraint(text).holds(c) for c in bench.conditions_seen for text in where)
    best = read_generations(tmp_path)[-1]["best"]["condition"]
    assert best["a"] + best["b"] == pytest.approx(-9, abs=0.3)  # the optimum lies on the constraint


def test_a_bound_that_only_a_linked_joint_breaks_keeps_the_candidate_from_running(tmp_path):
    def linked(condition):  # the other fin follows with angle 2 a and may go to 8 deg
        angle = 2 * condition["a"]
        return [Excess("angle of right_fin", angle, 8.0, "deg", 0.3)] if angle > 8 else []

    experiment = search_experiment(box("ab"), population=10, stop={"iterations": 15})
    bench = AnalyticBench(lambda c: c["a"])
    search(experiment, bench, tmp_path, limit_excesses=linked)
    assert max(c["a"] for c in bench.conditions_seen) <= 4
    states = read_generations(tmp_path)
    assert any(
        "angle of right_fin" in text for s in states for c in s["candidates"] for text in c["violations"]
    )
    assert states[-1]["best"]["value"] == pytest.approx(4, abs=0.3)


def test_an_infeasible_candidate_costs_more_than_any_feasible_and_more_the_more_it_violates(tmp_path):
    experiment = search_experiment(
        box("ab"), population=30, where=["a <= 0", "b <= 0"], stop={"iterations": 1}
    )
    search(experiment, AnalyticBench(hill), tmp_path)
    candidates = read_generations(tmp_path)[0]["candidates"]
    feasible = [c["cost"] for c in candidates if c["feasible"]]
    spread = max(feasible) - min(feasible)
    for candidate in candidates:
        if not candidate["feasible"]:
            a, b = candidate["condition"]["a"], candidate["condition"]["b"]
            number = (a > 0) + (b > 0)
            size = (max(a, 0) + max(b, 0)) / 10  # of the largest violation in the space
            assert candidate["cost"] == pytest.approx(max(feasible) + spread * (number + size), rel=0.01)


def test_a_search_without_any_feasible_point_ends_with_the_constraint_it_broke(tmp_path):
    experiment = search_experiment(box("ab"), where=["a >= 11"], stop={"iterations": 3})
    bench = AnalyticBench(hill)
    with pytest.raises(PlanError, match="a >= 11"):
        search(experiment, bench, tmp_path)
    assert bench.conditions_seen == []


@pytest.mark.parametrize("cut", [0, 1, 17, 40, 77, 130])
def test_an_interrupted_search_resumes_to_bit_identical_candidates(tmp_path, cut):
    experiment = search_experiment(
        box("ab"), repeats=2, population=8, reevaluate=2, restarts=1, stop={"stagnation": 4, "iterations": 14}
    )
    rule = RepeatRule(min=2, max=2)
    whole = AnalyticBench(hill, noise=0.3, repeats=rule)
    search(experiment, whole, tmp_path / "whole")
    stored = {}
    with pytest.raises(InterruptedBenchError):
        cut_short = AnalyticBench(hill, noise=0.3, repeats=rule, stored=stored, stop_after=cut)
        search(experiment, cut_short, tmp_path / "cut")
    resumed = AnalyticBench(hill, noise=0.3, repeats=rule, stored=stored)
    search(experiment, resumed, tmp_path / "cut")
    assert stored == whole.stored
    for file in (tmp_path / "whole").iterdir():
        assert file.read_bytes() == (tmp_path / "cut" / file.name).read_bytes()


def test_a_stored_generation_that_the_replay_does_not_repeat_is_an_error(tmp_path):
    experiment = search_experiment(box("ab"), stop={"iterations": 3})
    bench = AnalyticBench(hill)
    search(experiment, bench, tmp_path)
    path = tmp_path / "generation-000002.json"
    state = json.loads(path.read_text())
    state["sigma"] = state["sigma"] * (1 + 1e-15) + 1e-16
    path.write_text(json.dumps(state))
    with pytest.raises(StoreError, match="sigma of generation 2 differs"):
        search(experiment, AnalyticBench(hill, stored=bench.stored), tmp_path)


def test_restarts_double_the_population_and_begin_elsewhere(tmp_path):
    experiment = search_experiment(
        box("ab"), population=6, parents=3, restarts=2, stop={"step_size_below": 0.02, "iterations": 200}
    )
    search(experiment, AnalyticBench(hill), tmp_path)
    states = read_generations(tmp_path)
    first = {s["restart"]: s for s in reversed(states)}
    assert [first[k]["population"] for k in (0, 1, 2)] == [6, 12, 24]
    assert len({tuple(first[k]["mean"]) for k in (0, 1, 2)}) == 3


def test_leaders_measured_again_are_averaged_over_all_their_trials(tmp_path):
    experiment = search_experiment(box("ab"), population=10, reevaluate=3, stop={"iterations": 6})
    search(experiment, AnalyticBench(hill, noise=1.0), tmp_path)
    states = read_generations(tmp_path)
    again = [c for s in states[1:] for c in s["candidates"][: s["reevaluated"]]]
    assert [s["reevaluated"] for s in states] == [0, 3, 3, 3, 3, 3]
    assert all(len(c["values"]) >= 2 for c in again)
    assert all(c["value"] == pytest.approx(sum(c["values"]) / len(c["values"])) for c in again)


def test_the_search_stops_at_its_trials_and_never_beyond(tmp_path):
    experiment = search_experiment(box("ab"), population=10, repeats=2, stop={"trials": 70})
    bench = AnalyticBench(hill, noise=0.1, repeats=RepeatRule(min=2, max=2))
    search(experiment, bench, tmp_path)
    assert bench.ran == 60


def test_pure_noise_counts_as_stagnation(tmp_path):
    experiment = search_experiment(
        box("ab"), population=10, repeats=3, stop={"stagnation": 5, "iterations": 500}
    )
    bench = AnalyticBench(lambda c: 0.0, noise=1.0, repeats=RepeatRule(min=3, max=3))
    search(experiment, bench, tmp_path)
    assert len(read_generations(tmp_path)) < 60


def test_a_constant_objective_is_told_from_one_that_the_noise_hides(tmp_path):
    experiment = search_experiment(box("ab"), stop={"iterations": 30, "stagnation": 4})
    constant = search(experiment, AnalyticBench(lambda _: 0.25), tmp_path / "constant").verdict
    noisy = search(experiment, AnalyticBench(lambda _: 0.25, noise=0.1), tmp_path / "noisy").verdict
    assert (constant.ending, noisy.ending) == ("constant", "stagnated")


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**40])
def test_the_unit_of_an_objective_does_not_change_the_search(tmp_path, unit):
    experiment = search_experiment(box("ab"), stop={"iterations": 25})
    search(experiment, AnalyticBench(hill), tmp_path / "one")
    search(experiment, AnalyticBench(lambda c: unit * hill(c)), tmp_path / "other")
    first, other = read_generations(tmp_path / "one"), read_generations(tmp_path / "other")
    assert [state["mean"] for state in first] == [state["mean"] for state in other]


def test_a_limit_of_fewer_trials_than_a_generation_is_told_as_the_reason(tmp_path):
    experiment = search_experiment(box("ab"), population=12, stop={"trials": 3})
    verdict = search(experiment, AnalyticBench(hill), tmp_path).verdict
    assert verdict.trials == 12
    assert (
        "12 trials, more than stop.trials = 3: a search measures one whole generation at least"
        in verdict.text
    )
