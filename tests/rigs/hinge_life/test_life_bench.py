"""Hinges that tire and tear: lives on the bench, and what the fit says of them."""

import numpy as np
import pytest
from labrun_plugins.rigs.hinge_life.scene import LifeBench
from simulated_bench import sine

import labrun
from labrun.errors import RequestError, SpecError


def test_half_of_the_hinges_live_as_long_as_the_source_says():
    bench = LifeBench({}, np.random.default_rng(0))
    bench.arrange({"layup": "polyester", "specimen": 1, "range": 120})
    lives = []
    for number in range(1500):
        bench.mount(number)
        lives.append(bench.truth()["life"])
    assert np.median(lives) == pytest.approx(2500, rel=0.03)
    # of a Weibull distribution of shape 3 half lie between these
    assert np.mean((np.array(lives) > 1865) & (np.array(lives) < 3150)) == pytest.approx(0.5, abs=0.04)


def test_a_hinge_tires_and_its_torque_collapses_in_the_cycle_of_its_life():
    bench = LifeBench({"noise": 0, "shape": 3.0}, np.random.default_rng(0))
    bench._life = 12.5
    bench.observe(("torque_z",), np.array([0.0]))
    bench.drive("hinge", sine("hinge", 120.0, 1.0, 20.0), 0.5)
    torque = [
        np.abs(bench.observe(("torque_z",), 0.5 + cycle + np.arange(0.0, 1.0, 0.02))[:, 0]).max()
        for cycle in range(18)
    ]
    first = 0.0686 * np.radians(120)
    assert torque[0] == pytest.approx(first, rel=0.02)
    assert torque[10] == pytest.approx(first * (1 - 0.05), rel=0.02)
    assert np.all(np.array(torque[14:]) < 0.03 * first)


def test_a_rest_at_zero_between_two_stretches_is_no_cycle():
    bench = LifeBench({}, np.random.default_rng(0))
    bench.observe(("torque_z",), np.array([0.0]))
    for stretch in range(4):
        bench.drive("hinge", sine("hinge", 120.0, 1.0, 5.0), 0.5 + 6 * stretch)
        bench.observe(("torque_z",), np.array([0.5 + 6 * stretch + 5.9]))
    assert bench.truth()["cycles"] in (19, 20)


def test_a_hinge_that_nobody_measured_is_refused():
    with pytest.raises(SpecError, match="no hinge of 'steel'"):
        LifeBench({"layup": "steel"}, np.random.default_rng(0))


def test_a_bench_put_back_goes_on_exactly_as_it_was():
    def made():
        bench = LifeBench({}, np.random.default_rng(3))
        bench.observe(("torque_z",), np.array([0.0]))
        return bench

    bench, other = made(), made()
    bench.drive("hinge", sine("hinge", 120.0, 1.0, 20.0), 0.5)
    bench.observe(("torque_z",), np.array([7.3]))
    other.restore(bench.snapshot())
    time_s = np.arange(7.4, 15.0, 0.05)
    np.testing.assert_array_equal(bench.observe(("torque_z",), time_s), other.observe(("torque_z",), time_s))
    assert other.truth() == bench.truth()


def test_lives_of_a_run_are_fitted_and_what_outlived_it_is_more_than_a_number(tmp_path):
    conditions = ",".join(
        f'{{layup="{layup}",specimen={n},range=120}}'
        for layup, n in [("polyester", 1), ("polyester", 2), ("polyester", 3), ("sandwich", 1)]
    )
    small = [f"run.conditions=[{conditions}]", "trial.until.max_cycles=1500", "rig.devices.wrench.rate_hz=5"]
    scene = ["rig.scene={plugin='life-bench', shape=1.0}"]
    run = labrun.run("hinge-life", dry_run=True, seed=3, overrides=small + scene, results=tmp_path).run
    result = labrun.fit(run)
    lives = {life["kind"]: life for life in result.details["lives"]}
    assert lives["layup = sandwich, range = 120"]["censored"] == [True]
    assert any("sandwich" in text and "> 1,500 cycles" in text for text in result.findings)
    assert not any("sandwich" in name for name in result.parameters)
    assert any("falls by" in text for text in result.findings)


def test_every_kept_cycle_is_a_trial_of_its_own_to_a_model(tmp_path):
    small = [
        'run.conditions=[{layup="sandwich",specimen=1,range=120}]', "trial.until.max_cycles=150",
        "trial.until.keep_every=50", 'trial.until.when="cycle > 1e9"',
    ]  # fmt: skip
    run = labrun.run("hinge-life", dry_run=True, seed=3, overrides=small, results=tmp_path).run
    comparison = labrun.compare(run, model="turned-hinge", results=tmp_path).comparison
    assert [dict(pair.condition)["cycle"] for pair in comparison.pairs] == [0.0, 50.0, 100.0]
    assert all(pair.time_s[0] < 0.1 and 2.7 < pair.time_s[-1] < 2.86 for pair in comparison.pairs)
    # the torque has fallen by 5 % a decade in both
    assert np.ptp(comparison.pairs[2].measured) < 0.92 * np.ptp(comparison.pairs[0].measured)
    assert comparison.worst.relative < 0.02


def test_a_run_without_lives_is_told_what_it_lacks(tmp_path):
    small = ["run.conditions=[{release=30}]", "trial.repeats=1", "trial.duration_s=1"]
    run = labrun.run("hinge", dry_run=True, seed=1, overrides=small, results=tmp_path).run
    with pytest.raises(RequestError, match="do not run until something happens"):
        labrun.fit(run, model="life")
