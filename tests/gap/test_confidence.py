"""A diagnosis of poorer data is never as sure as one of rich data."""

from dataclasses import replace

import numpy as np
import pytest
from labrun.gap.confidence import ceiling, confidence

from labrun.gap.pipeline import search_causes

from .benches import dry_friction, pendulum, recorded


def test_noise_told_without_repeats_and_one_condition_each_lower_what_is_said_at_most() -> None:
    rich = ceiling("repeats", 4)
    assert ceiling("residual", 4) < rich
    assert ceiling("repeats", 1) < rich


def test_one_trial_is_less_sure_than_either_of_its_lacks_alone() -> None:
    assert ceiling("residual", 1) < min(ceiling("residual", 4), ceiling("repeats", 1))


def test_a_cause_that_little_comes_back_without_is_less_sure_where_repeats_show_what_forms_lack() -> None:
    assert (
        ceiling("repeats", 4, own_share=0.02) < ceiling("repeats", 4, own_share=0.3) == ceiling("repeats", 4)
    )
    assert ceiling("residual", 4, own_share=0.02) == ceiling("residual", 4)


@pytest.mark.slow
def test_of_causes_that_stand_in_for_one_another_the_one_that_explains_most_alone_stays_sure() -> None:
    search = search_causes(recorded(dry_friction(0.006)), pendulum(), np.random.default_rng(0))
    (friction,) = search.selection.chosen
    weaker = [one for one in search.selection.rounds[0].rated if one.share < friction.rated.share]
    other = max(weaker, key=lambda one: one.share)
    chosen = replace(friction, own_share=0.02), replace(friction, rated=other, own_share=0.02)
    both = replace(search, selection=replace(search.selection, chosen=chosen))
    first, second = (confidence(both, one) for one in chosen)
    assert first == confidence(search, friction) > 0.5
    assert second <= 0.2
