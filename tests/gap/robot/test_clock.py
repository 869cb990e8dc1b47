"""Goals that one logger stamps early or late beside all angles, from all joints together."""

from dataclasses import replace

import numpy as np
import pytest
from test_tip_load import FAR_END_M, SAMPLE_S, logged

from labrun.gap.robot.clock import common_lead
from labrun.gap.robot.one_joint import Prescribed, one_joint, prescribed

RNG = 5
STEP_S = 1e-3


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return logged(tmp_path_factory.mktemp("log"), 0.0, FAR_END_M, 0.95)


def with_angles_early(result: Prescribed, samples: list[int]) -> Prescribed:
    """Return a log in which the angle of each joint was stamped so many samples early; late if negative."""
    trials = []
    for trial in result.dataset.trials:
        outputs = np.column_stack(
            [np.roll(column, -by) for column, by in zip(trial.outputs.T, samples, strict=True)]
        )
        inside = slice(5, -5)
        trials.append(
            replace(trial, time_s=trial.time_s[:-10], inputs=trial.inputs[inside], outputs=outputs[inside])
        )
    return prescribed(result.robot, result.whole, replace(result.dataset, trials=tuple(trials)))


@pytest.mark.parametrize("samples", [3, pytest.param(-2, marks=pytest.mark.slow)])
def test_a_clock_that_all_joints_share_is_found_beside_gains_that_are_off(log, samples):
    result = with_angles_early(log, [samples] * 4)
    lead_s = common_lead(result, np.random.default_rng(RNG))
    # the simulator that wrote the log moves on with the rates at the end of its steps: early by half of one
    assert lead_s == pytest.approx(samples * SAMPLE_S + 0.5 * STEP_S, abs=2e-4)


@pytest.mark.parametrize("samples", [[0, 0, 3, 0], [0, 2, 0, -2]])
def test_joints_that_do_not_agree_have_no_common_clock(log, samples):
    result = with_angles_early(log, samples)
    assert common_lead(result, np.random.default_rng(RNG)) == 0.0


def test_a_joint_of_such_a_log_has_the_clock_in_its_model(tmp_path):
    result = logged(tmp_path, 0.0, FAR_END_M, 1.0)
    (late,) = one_joint(result.led(0.02), 1).model.effects
    (delayed,) = one_joint(result.led(-0.02), 1).model.effects
    assert (late.effect.id, late.values) == ("late-clock", (0.02,))
    assert (delayed.effect.id, delayed.values) == ("delay", (0.02,))
    assert one_joint(result, 1).model.effects == ()
