"""A bench's memory: what is stored and taken back continues to the last bit, however it is looked at."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_bench import line, sine

from labrun import registry
from labrun.devices import Scene
from labrun.errors import ExperimentError

SCENES = {
    "hinge-bench": {"hide": [{"effect": "coulomb-friction", "site": "hinge"}]},
    "caudal-tank": {"hide": [{"effect": "delay", "site": "tail", "values": {"delay": 0.05}}]},
    "fire-tank": {"hide": [{"effect": "lag", "site": "torque_z", "values": {"time_constant": 0.05}}]},
    "fire-free": {"hide": [{"effect": "drag-error", "site": "fish"}], "caudal": "on"},
    "driven-joint": {"hide": [{"effect": "lag", "site": "horn"}]},
    "spm-stabiliser": {"hide": [{"effect": "coulomb-friction", "site": "axis_1"}]},
}


def _scene(name, seed=5):
    return registry.load("labrun.scenes", name)(SCENES[name], np.random.default_rng(seed))


def _moved(name):
    scene = _scene(name)
    scene.observe(list(scene.signals), np.array([0.0]))
    joint = scene.joints[0]
    if name == "hinge-bench":
        scene.drive(joint, line(joint, [0.0, 40.0, 40.0], [0.0, 0.5, 1.0]), 0.1)
    else:
        scene.drive(joint, sine(joint, 40, 1.4, 3.0), 0.1)
    if name == "fire-tank":
        scene.tow(0.0, 0.4, 0.1, 0.5)
    return scene


def _rest(scene):
    joint = scene.joints[0]
    return scene.drive(joint, line(joint, [0.0, 10.0], [0.0, 0.5]), 4.0)


@pytest.mark.parametrize("name", SCENES)
def test_a_bench_is_a_scene(name):
    scene: Scene = _scene(name)
    values = scene.observe(list(scene.signals), np.array([0.0, 0.1]))
    assert values.shape == (2, len(scene.signals))
    assert np.isfinite(values).all()
    json.dumps(scene.truth())


@pytest.mark.parametrize("name", SCENES)
@settings(max_examples=5, deadline=None)
@given(split=st.floats(0.05, 5.5))
def test_a_restored_bench_goes_on_to_the_last_bit(name, split):
    whole = _moved(name)
    signals = list(whole.signals)
    whole.observe(signals, np.array([split]))
    stored = json.loads(json.dumps(whole.snapshot()))
    again = _scene(name, seed=99)
    again.restore(stored)
    for scene in (whole, again):
        if split < 4.0:
            _rest(scene)
    later = np.linspace(split, split + 3.0, 400)
    np.testing.assert_array_equal(whole.observe(signals, later), again.observe(signals, later))
    assert json.dumps(whole.snapshot()) == json.dumps(again.snapshot())


@pytest.mark.parametrize("name", SCENES)
@settings(max_examples=5, deadline=None)
@given(looks=st.lists(st.floats(0.001, 0.5), min_size=1, max_size=12))
def test_how_often_a_bench_is_looked_at_changes_nothing(name, looks):
    once, often = _moved(name), _moved(name)
    signals = list(once.signals)
    time_s = 0.0
    for look in looks:
        time_s += look
        often.observe(signals[:1], np.array([time_s]))
    at = np.linspace(time_s, time_s + 1.0, 100)
    np.testing.assert_array_equal(once.observe(signals, at), often.observe(signals, at))


@pytest.mark.parametrize("name", SCENES)
def test_the_same_seed_gives_the_same_bench_and_another_seed_another(name):
    at = np.linspace(0.0, 4.0, 300)
    same = [_moved(name) for _ in range(2)]
    values = [scene.observe(list(scene.signals), at) for scene in same]
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize("name", SCENES)
def test_between_trials_a_snapshot_is_small(name):
    scene = _moved(name)
    _rest(scene)
    scene.observe(list(scene.signals), np.array([30.0]))
    assert len(json.dumps(scene.snapshot())) < 60_000


def test_looking_back_too_far_is_an_error_and_no_guess():
    scene = _moved("caudal-tank")
    scene.observe(["force_x"], np.array([2.0]))
    other = _scene("caudal-tank")
    other.restore(scene.snapshot())
    with pytest.raises(ExperimentError, match="it knows"):
        other.observe(["force_x"], np.array([1.0]))


def test_a_joint_a_bench_lacks_and_a_carriage_it_lacks_are_errors():
    scene = _scene("caudal-tank")
    with pytest.raises(ExperimentError, match="no joint 'fluke'"):
        scene.drive("fluke", line("fluke", [0.0], [0.0]), 0.0)
    with pytest.raises(ExperimentError, match="no carriage"):
        scene.tow(0.0, 1.0, 0.1, 0.0)
