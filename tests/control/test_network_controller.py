"""Learned models in charge of a loop, and trained on beside it."""

import os
import signal
import time

import numpy as np
import pytest

from labrun.control.learning import InlineLearner, LearnerTask, ProcessLearner
from labrun.control.loop import Loop
from labrun.control.network import NetworkController
from labrun.control.protocol import LoopContext, VectorStep
from labrun.errors import ExperimentError, SpecError
from labrun.experiment import LoopTable
from labrun.learned import LearnedModel, Network, Scaling, to_table

TRUE = np.array([[2.0, -1.0], [0.5, 3.0]])


def affine(weights, bias=(0.0, 0.0)):
    scaling = Scaling(np.zeros(2), np.ones(2))
    return Network(
        (np.array(weights, dtype=float),), (np.array(bias, dtype=float),), "identity", scaling, scaling
    )


def model(network=None, **changes):
    keys = {"inputs": {"a": "1", "b": "1"}, "outputs": {"u": "deg", "v": "deg"}, "rig": "bench"}
    return to_table(LearnedModel(network or affine(TRUE), **{**keys, **changes}))


def context(**changes):
    keys = {"components": ("a", "b"), "drives": {"u": "deg", "v": "deg"}, "rig": "bench"}
    return LoopContext(0.01, -10.0, 10.0, 0.0, **{**keys, **changes})


def step(reference=(1.0, 2.0), time_s=0.0, feedback=(0.0, 0.0), **channels):
    at = dict.fromkeys(channels, time_s)
    return VectorStep(
        time_s, 0.01, reference, feedback, (0.0, 0.0), lambda _: reference, time_s, channels, at
    )


def test_a_network_says_the_drives_by_their_names():
    update = NetworkController({"model": model()}, context()).update(step())
    assert update == pytest.approx((3.0, 5.0))
    turned = NetworkController(
        {"model": model()}, context(components=("b", "a"), drives={"v": "deg", "u": "deg"})
    )
    assert turned.update(step((2.0, 1.0))) == pytest.approx((5.0, 3.0))


def test_any_activation_is_computed():
    deep = Network(
        (np.eye(2), np.eye(2)), (np.zeros(2),) * 2, "tanh", affine(TRUE).inputs, affine(TRUE).outputs
    )
    update = NetworkController({"model": model(deep)}, context()).update(step())
    assert update == pytest.approx(np.tanh([1.0, 2.0]))


def test_a_network_that_corrects_an_inverse_is_added_to_it():
    added = model(added_to="spm-inverse", inputs={"qw": "1", "qx": "1"})
    loop = context(components=("qw", "qx", "qy", "qz"))
    update = NetworkController({"model": added}, loop).update(step((1.0, 0.0, 0.0, 0.0)))
    assert update == pytest.approx((2.0, -1.0))


@pytest.mark.parametrize(
    ("table", "loop", "message"),
    [
        ({"rig": "other"}, {}, "another rig: other, and this is bench"),
        ({}, {"components": ("a", "c")}, "the loop has no b, which the weights need"),
        ({}, {"drives": {"u": "deg", "w": "deg"}}, "the weights give u, v, and the loop drives u, w"),
        ({"outputs": {"u": "rad", "v": "rad"}}, {}, "give u in rad, and the loop sets it in deg"),
    ],
)
def test_weights_of_something_else_are_refused_in_words(table, loop, message):
    with pytest.raises(SpecError, match=message):
        NetworkController({"model": model(**table)}, context(**loop))


def test_a_network_that_gives_no_number_ends_the_run_with_variable_and_time_named():
    huge = 1e308
    table = LoopTable.model_validate(
        {
            "drives": ["u", "v"],
            "range": (-10.0, 10.0),
            "reference": [{"plugin": "constant", "value": 1e3}, {"plugin": "constant", "value": -1e3}],
            "feedback": [{"plugin": "latest", "channel": "x.a"}, {"plugin": "latest", "channel": "x.b"}],
            "controllers": {
                "net": {"plugin": "network", "model": model(affine([[huge, huge], [huge, huge]]))}
            },
        }
    )
    loop = Loop("pose", table, [], {}, context(), None)
    with pytest.raises(ExperimentError, match=r"controller net asks for u = nan at 0\.250 s"):
        loop._feedbacks = (lambda *_: (0.0, 0.0),)
        loop.step(0.25, 0.01, {"u": 0.0, "v": 0.0}, type("H", (), {"newest_s": lambda *_: 0.0})())


def samples(count, seed=0):
    x = np.random.default_rng(seed).normal(size=(count, 2))
    return x, x @ TRUE


def test_a_learner_in_simulated_time_gives_its_weights_as_late_as_it_is_told():
    learner = InlineLearner(LearnerTask(affine(np.zeros((2, 2))), 100, 1e-9), 0.02)
    x, y = samples(50)
    for row in range(50):
        learner.give(0.0, x[row], y[row])
    assert learner.newest(0.0) is None
    assert learner.newest(0.01) is None
    newest = learner.newest(0.021)
    np.testing.assert_allclose(newest.weights[0], TRUE, atol=1e-5)
    assert (learner.lag_s, learner.trainings) == (pytest.approx(0.021), 1)


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_weights_that_are_no_numbers_are_not_taken():
    learner = InlineLearner(LearnerTask(affine(np.zeros((2, 2))), 100, 1e-9), 0.01)
    learner.give(0.0, [1e200, 0.0], [0.0, 0.0])  # its square is not a number any more
    learner.newest(0.0)
    assert learner.newest(0.02) is None
    assert (learner.alive, learner.trainings) == (False, 0)
    assert "those of the file" in learner.remarks[0]


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_a_learner_in_a_process_of_its_own_learns_and_its_death_leaves_the_last_weights():
    learner = ProcessLearner(LearnerTask(affine(np.zeros((2, 2))), None, 1e-9))
    learner.begin()
    try:
        until(learner.ready)
        x, y = samples(60)
        results = []
        for row in range(60):
            learner.give(0.01 * row, x[row], y[row])

        def weights():
            newest = learner.newest(1.0)
            results.extend([] if newest is None else [newest])
            return bool(results) and np.allclose(results[-1].weights[0], TRUE, atol=1e-4)

        until(weights)
        assert learner.training_s > 0
        assert learner.lag_s == pytest.approx(1.0 - 0.59)
        os.kill(learner.pid, signal.SIGKILL)
        now = [1.0]

        def dead():
            now[0] += 1.0
            assert learner.newest(now[0]) is None
            return not learner.alive

        until(dead)
        assert "its process died (killed by SIGKILL)" in learner.remarks[0]
        learner.give(2.0, x[0], y[0])
    finally:
        learner.end()


def test_a_controller_that_learns_follows_what_it_measures_and_records_it():
    keys = {"model": model(affine(np.zeros((2, 2)))), "history_s": 1.0}
    keys["learn"] = {"measured": {"u": "s.u", "v": "s.v"}, "simulated_s": 0.01}
    controller = NetworkController(keys, context())
    x, y = samples(200)
    rad = np.radians(y)
    for row in range(200):
        channels = {"s.u": rad[row, 0], "s.v": rad[row, 1]}
        update = controller.update(step((1.0, 2.0), 0.01 * row, tuple(x[row]), **channels))
    assert update == pytest.approx((3.0, 5.0), abs=0.01)
    recorded = controller.recorded()
    assert set(recorded) == set(NetworkController.records(keys))
    assert recorded["trainings"] > 50
    assert recorded["weights_age_s"] <= 0.02
    assert NetworkController.records({"model": "x"}) == {}
