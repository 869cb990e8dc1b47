"""Repeats that one simulation predicts are averaged; others stay apart."""

from dataclasses import replace

import numpy as np

from labrun.gap.averaging import averaged

from .benches import CONDITIONS, pendulum, recorded


def shifted(trial, by_s):
    """Return the same trial, sampled a little later."""
    time_s = trial.time_s + by_s

    def at(values):
        return np.column_stack([np.interp(time_s, trial.time_s, column) for column in values.T])

    return replace(trial, time_s=time_s, inputs=at(trial.inputs), outputs=at(trial.outputs))


def test_repeats_of_one_command_are_one_unit():
    units = averaged(recorded(conditions=CONDITIONS[:2]), pendulum())
    assert [unit.count for unit in units.trials] == [3, 3]


def test_repeats_sampled_at_other_instants_are_one_unit_and_their_mean_is_the_motion():
    quiet = recorded(conditions=CONDITIONS[:1], noise=0.0)
    first, *others = quiet.trials
    apart = replace(
        quiet, trials=(first, *(shifted(index, by) for index, by in zip(others, (0.003, 0.006), strict=True)))
    )
    (unit,) = averaged(apart, pendulum()).trials
    assert unit.count == 3
    amplitude = float(np.max(np.abs(first.outputs)))
    # the trials themselves were interpolated linearly here; a sample apart they would differ by ten times as much
    assert np.max(np.abs(unit.outputs - first.outputs)[2:-2]) < 2e-3 * amplitude


def test_long_repeats_that_lost_a_few_samples_are_one_unit():
    dataset = recorded(conditions=CONDITIONS[:1])
    samples = np.arange(10_000)

    def long(trial, lost):
        left = np.delete(samples, 1050 + 1000 * np.arange(lost))  # one here and there
        inputs, outputs = (
            np.resize(values[:100], (10_000, 1))[left] for values in (trial.inputs, trial.outputs)
        )
        return replace(trial, time_s=0.01 * left, inputs=inputs, outputs=outputs)

    trials = tuple(long(trial, lost) for trial, lost in zip(dataset.trials, (0, 5, 8), strict=True))
    (unit,) = averaged(replace(dataset, trials=trials), pendulum()).trials
    assert unit.count == 3


def test_trials_with_another_course_of_the_input_stay_apart():
    dataset = recorded(conditions=CONDITIONS[:1])
    first, second, third = dataset.trials
    louder = replace(second, inputs=1.1 * second.inputs)
    assert len(averaged(replace(dataset, trials=(first, louder, third)), pendulum()).trials) == 3


def test_repeats_that_seem_to_begin_elsewhere_are_one_unit_where_the_model_says_how_all_begin():
    dataset = recorded(conditions=CONDITIONS[:1])
    first, *others = dataset.trials
    jolted = first.outputs.copy()
    jolted[:3] += 1.0
    (unit,) = averaged(replace(dataset, trials=(replace(first, outputs=jolted), *others)), pendulum()).trials
    assert unit.count == 3
