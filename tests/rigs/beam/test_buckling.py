"""Limits of buckling beams: read off single trials, damaged by a snap, held beside theory."""

import numpy as np
import pytest
from labrun_plugins.rigs.beam.limits import BucklingLimitObjective, buckling_limit
from labrun_plugins.rigs.beam.scene import LIMITS_N_M, BeamBench

import labrun
from labrun.devices import Trajectory
from labrun.errors import ExperimentError
from labrun.models import load_model, simulate

LEVER_M = 0.1


def there_and_back(made, to_m, *, from_s=1.0, way_s=50.0):
    made.observe(("force",), np.array([from_s - 1.0]))
    points = np.array([[0.0], [to_m], [0.0]])
    made.drive("pusher", Trajectory(("pusher",), np.array([0.0, way_s, 2 * way_s]), points), from_s)
    time_s = from_s + np.arange(0.0, 2 * way_s, 0.1)
    signals = np.vstack([made.observe(("force", "position"), part) for part in np.array_split(time_s, 10)])
    return signals[:, 0], signals[:, 1]


def bench(seed=0, **keys):
    return BeamBench({"noise": 0, **keys}, np.random.default_rng(seed))


@pytest.mark.parametrize("beam", ["long", "short", "steel"])
@pytest.mark.parametrize("way", [-0.05, 0.05])
def test_the_limit_of_a_beam_is_read_off_whatever_its_loop(beam, way):
    limit = buckling_limit(*there_and_back(bench(beam=beam), way), LEVER_M)
    equal, opposite = LIMITS_N_M[beam]
    assert limit.reached
    assert limit.sense == ("opposite" if way > 0 else "equal")
    assert limit.torque_n_m == pytest.approx(opposite if way > 0 else equal, rel=0.01)


@pytest.mark.parametrize("beam", ["long", "short", "polyester", "steel"])
def test_the_model_file_knows_every_beam_of_the_bench(beam):
    force, way_m = there_and_back(bench(beam=beam, as_modelled=True), 0.05)
    model = load_model("buckling-beam")
    time_s = np.arange(len(force)) / 10.0
    message = simulate(model, time_s, way_m[:, None], condition={"beam": beam}).outputs[:, 0]
    np.testing.assert_allclose(message, force, atol=0.01 * np.abs(force).max())


@pytest.mark.parametrize("way", [-0.004, 0.02])
def test_a_beam_that_was_not_bent_far_enough_has_not_reached_its_limit(way):
    limit = buckling_limit(*there_and_back(bench(), way), LEVER_M)
    assert not limit.reached
    assert limit.torque_n_m == pytest.approx(2.0 * abs(way) / LEVER_M, rel=0.05)


def test_a_snap_costs_a_beam_a_part_of_both_limits_and_a_new_one_has_them_again():
    made = bench()
    first = buckling_limit(*there_and_back(made, 0.05), LEVER_M).torque_n_m
    assert made.truth()["damaged"]
    again = buckling_limit(*there_and_back(made, 0.05, from_s=150.0), LEVER_M).torque_n_m
    equal = buckling_limit(*there_and_back(made, -0.05, from_s=300.0), LEVER_M).torque_n_m
    assert again == pytest.approx(0.7 * first, rel=0.01)
    assert equal == pytest.approx(0.7 * LIMITS_N_M["long"][0], rel=0.02)
    made.mount(2)
    assert not made.truth()["damaged"]
    fresh = buckling_limit(*there_and_back(made, 0.05, from_s=450.0), LEVER_M).torque_n_m
    assert fresh == pytest.approx(first, rel=0.01)


def test_a_bench_put_back_in_the_middle_of_a_snap_goes_on_as_it_was():
    made, other = bench(), bench()
    made.observe(("force",), np.array([0.0]))
    other.observe(("force",), np.array([0.0]))
    points = np.array([[0.0], [0.05], [0.0]])
    made.drive("pusher", Trajectory(("pusher",), np.array([0.0, 50.0, 100.0]), points), 1.0)
    made.observe(("force",), np.array([45.0]))
    other.restore(made.snapshot())
    time_s = np.arange(45.1, 100.0, 0.5)
    np.testing.assert_array_equal(made.observe(("force",), time_s), other.observe(("force",), time_s))


def test_the_loop_of_steel_is_the_larger_one():
    def area(beam):
        force, way = there_and_back(bench(beam=beam), -0.05)
        return np.trapezoid(force, way)

    assert area("steel") > 2 * area("polyester") > 0


def test_a_way_that_does_not_come_back_is_refused():
    with pytest.raises(ExperimentError, match="did not go there and back"):
        buckling_limit(np.linspace(0, 5, 500), np.linspace(0, 0.05, 500), LEVER_M)


def test_keys_of_the_objective_that_do_not_hold_are_refused():
    with pytest.raises(ValueError, match="lever_mm"):
        BucklingLimitObjective("stage.force", {"over": "stage.displacement", "lever_mm": -1})


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_the_fit_says_that_the_arc_holds_and_finds_the_published_limits(seed, tmp_path):
    conditions = ",".join(
        f'{{beam="{beam}",specimen={number},reach={reach}}}'
        for beam in ("long", "short")
        for number in (1, 2, 3)
        for reach in (-28.648, 28.648)
    )
    small = [f"run.conditions=[{conditions}]", "gait.joints.bend.step_deg=0.05"]
    run = labrun.run("beam-buckling", dry_run=True, seed=seed, overrides=small, results=tmp_path).run
    trials = labrun.open(run).trials
    for beam in ("long", "short"):
        for sign, limit in zip((-1, 1), LIMITS_N_M[beam], strict=True):
            own = trials[(trials["beam"] == beam) & (np.sign(trials["reach"]) == sign)]
            assert len(own) == 3
            assert own["limit"].mean() == pytest.approx(limit, rel=0.03)
    result = labrun.fit(run)
    assert result.parameters["opposite_by_arc"].value == pytest.approx(0.85, rel=0.03)
    assert result.parameters["opposite_by_chord"].value == pytest.approx(0.23, rel=0.04)
    low, high = result.parameters["opposite_limit"].ci95
    assert low < 0.76 < high
    assert any("arc, r theta, holds" in text for text in result.findings)
    assert {row[0] for row in result.tables[0].rows} == {"long", "short"}
