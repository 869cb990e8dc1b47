"""A diagnosis of poorer data is never as sure as one of rich data."""

from labrun.gap.confidence import ceiling


def test_noise_told_without_repeats_and_one_condition_each_lower_what_is_said_at_most() -> None:
    rich = ceiling("repeats", 4)
    assert ceiling("residual", 4) < rich
    assert ceiling("repeats", 1) < rich


def test_one_trial_is_no_surer_than_either_of_its_lacks() -> None:
    assert ceiling("residual", 1) == min(ceiling("residual", 4), ceiling("repeats", 1))


def test_a_cause_that_little_comes_back_without_is_less_sure_where_repeats_show_what_forms_lack() -> None:
    assert (
        ceiling("repeats", 4, own_share=0.02) < ceiling("repeats", 4, own_share=0.3) == ceiling("repeats", 4)
    )
    assert ceiling("residual", 4, own_share=0.02) == ceiling("residual", 4)
