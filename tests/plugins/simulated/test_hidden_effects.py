"""Effects that a bench is told to hide: from the experiment file into the scene, at a size that shows."""

import numpy as np
import pytest
from simulated_bench import line, sine

from labrun import registry
from labrun.effects import effects
from labrun.errors import SpecError
from labrun.experiment import load_experiment, shipped_experiments
from labrun.runner import Rig, SimulatedClock


def _scene(experiment, *overrides):
    loaded = load_experiment(shipped_experiments() / f"{experiment}.toml", overrides)
    return Rig.build(loaded.experiment, clock=SimulatedClock(), seed=1, dry_run=True).scene


def _bench(name, hide):
    return registry.load("labrun.scenes", name)({"noise": 0, "hide": hide}, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("experiment", "hidden", "message"),
    [
        ("hinge", '{ effect = "coulomb-friction", site = "hinge" }', ("coulomb-friction", "hinge")),
        ("fin-params", '{ effect = "delay", site = "tail" }', ("delay", "tail")),
        ("turn-torque", '{ effect = "gain-error", site = "torque_z" }', ("gain-error", "torque_z")),
    ],
)
def test_a_set_on_the_command_line_hides_an_effect_by_its_plain_id(experiment, hidden, message):
    assert _scene(experiment).truth()["hidden"] == []
    (effect,) = _scene(experiment, f"rig.scene.hide=[{hidden}]").truth()["hidden"]
    assert (effect["effect"], effect["site"]) == message
    assert all(np.isfinite(value) for value in effect["values"].values())


def test_values_in_the_file_reach_the_bench_in_si():
    override = 'rig.scene.hide=[{effect="coulomb-friction", site="hinge", values={torque=4e-4}}]'
    (effect,) = _scene("hinge", override).truth()["hidden"]
    assert effect["values"]["torque"] == 4e-4


def test_an_effect_that_there_is_not_is_refused_with_what_was_asked_for():
    with pytest.raises(SpecError, match="coulomb-frction"):
        _scene("hinge", 'rig.scene.hide=[{effect="coulomb-frction", site="hinge"}]')


def _swing(hide):
    bench = _bench("hinge-bench", hide)
    bench.observe(["hinge"], np.array([0.0]))
    bench.drive("hinge", line("hinge", [0.0, 40.0, 40.0], [0.0, 1.0, 2.0]), 0.0)
    return bench.observe(["hinge"], 2.0 + np.arange(0.0, 3.0, 0.005))


def _strokes(hide):
    bench = _bench("caudal-tank", hide)
    bench.observe(["force_x"], np.array([0.0]))
    bench.drive("tail", sine("tail", 40, 1.4, 8.0), 1.0)
    return bench.observe(["force_x"], np.arange(4.0, 9.0, 0.01))


def _of_kinds(*kinds):
    """Return the effects of these kinds; no bench says what load its joints carry."""
    return sorted({effect.id for effect in effects() if effect.kind in kinds and "load" not in effect.needs})


@pytest.mark.parametrize(
    ("motion", "effect", "site"),
    [(_swing, effect, "hinge") for effect in _of_kinds("joint")]
    + [(_strokes, effect, "tail") for effect in _of_kinds("input")]
    + [(_strokes, effect, "force_x") for effect in _of_kinds("output")],
)
def test_without_values_an_effect_has_a_size_that_shows_and_does_not_swamp_the_bench(motion, effect, site):
    plain, hidden = motion([]), motion([{"effect": effect, "site": site}])
    share = np.abs(hidden - plain).max() / np.abs(plain).max()
    assert 0.005 < share < 1.5
