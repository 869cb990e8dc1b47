"""Of a search's many candidates the diagnosis takes what was repeated, and others far from each other."""

import numpy as np
import pytest

from labrun.gap.averaging import averaged, without_crowding

from .benches import pendulum, recorded


def searched(once: int, repeats: int):
    """Return trials of three conditions that were repeated, and of others that were not, along one axis."""
    data = recorded(repeats=1)
    trial = data.trials[0]
    from dataclasses import replace

    leaders = [
        replace(trial, condition={"release": 10.0 + index}, repeat=repeat)
        for index in range(3)
        for repeat in range(repeats)
    ]
    others = [replace(trial, condition={"release": float(release)}) for release in np.linspace(20, 90, once)]
    return averaged(replace(data, trials=tuple(leaders + others)), pendulum())


def test_what_was_repeated_stays_and_the_rest_is_spread_over_the_range():
    dataset = without_crowding(searched(100, 5))
    assert len(dataset.conditions) < 20
    releases = sorted(trial.condition["release"] for trial in dataset.trials)
    assert releases[:3] == [10.0, 11.0, 12.0]
    assert releases[-1] == 90.0
    assert np.diff(releases[3:]).max() < 30
    assert sorted({trial.group for trial in dataset.trials}) == list(range(len(dataset.conditions)))
    assert f"of 103 conditions {len(dataset.conditions)} were looked at" in dataset.notes[-1]


@pytest.mark.parametrize(("once", "repeats"), [(4, 5), (100, 1)])
def test_few_conditions_and_data_without_repeats_are_taken_whole(once, repeats):
    data = searched(once, repeats)
    assert without_crowding(data) is data
