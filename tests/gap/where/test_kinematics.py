"""Equations that hold by definition are known from those that may lack a force."""

import numpy as np
import pytest
from labrun.gap.where.equations import defined
from where_cases import made

from labrun.gap.where import find_places


@pytest.fixture(scope="module")
def difference():
    return made(np.random.default_rng(5))


def test_the_equation_of_an_angle_holds_by_definition_and_that_of_its_rate_does_not(difference):
    assert [difference.model.states[state] for state in defined(difference)] == ["angle"]


@pytest.mark.slow
def test_the_angle_is_not_asked_which_force_it_lacks(difference):
    places = find_places(difference, np.random.default_rng(0), draws=19)
    assert {one.at for one in places if one.by == "equation"} == {
        "rate", *(f"{one.name} (output)" for one in difference.model.outputs)
    }  # fmt: skip


def test_a_band_of_frequencies_makes_up_at_least_the_power_that_the_signal_has_there(difference):
    places = find_places(difference, np.random.default_rng(0), draws=5)
    parts = {one.at: one.part for one in places if one.by == "frequency"}
    assert parts["at the drive"] > 0.9  # a sine
    assert all(0.0 <= part <= 1.0 for part in parts.values())
