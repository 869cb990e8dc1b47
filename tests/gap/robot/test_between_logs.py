"""Logs of one robot that ask for other sizes are told apart, and logs of the same robot are not."""

from dataclasses import replace

import pytest
from test_file_check import FRICTION, diagnosis, logged

from labrun.gap import differences_between_logs

pytest.importorskip("mujoco")


def two_logs(folder, first, second):
    """Return robot, model, and the same motions with dry friction of two sizes at the elbow, a log each."""
    logs = []
    for name, friction in (("monday", first), ("tuesday", second)):
        robot, model, dataset = logged(folder, friction)
        logs += [
            replace(trial, label=f"{name} {trial.label}", condition={**trial.condition, "log": name})
            for trial in dataset.trials[:2]
        ]
    return robot, model, replace(dataset, trials=tuple(logs))


def test_friction_that_another_log_has_twice_is_told_with_both_sizes(tmp_path):
    robot, model, dataset = two_logs(tmp_path, 0.4, 0.8)
    (sentence,) = differences_between_logs(robot, model, dataset, diagnosis({}, {}, [FRICTION]))
    assert sentence.startswith("elbow differs by log: torque of Coulomb friction ")
    sizes = [float(part.split()[-3]) for part in sentence.split(", ")]
    assert sizes == pytest.approx([0.4, 0.8], rel=0.15)


@pytest.mark.slow
def test_logs_of_the_same_robot_do_not_differ(tmp_path):
    robot, model, dataset = two_logs(tmp_path, 0.4, 0.4)
    assert differences_between_logs(robot, model, dataset, diagnosis({}, {}, [FRICTION])) == ()
