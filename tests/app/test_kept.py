"""Files that are called after a name."""

from hypothesis import given
from hypothesis import strategies as st

from labrun.app.kept import stem_of

NAMES = st.text(st.sampled_from("ab.-_/ \u00e4\u00f6"), min_size=1, max_size=4)


@given(first=NAMES, second=NAMES)
def test_different_names_give_different_files(first, second):
    assert (stem_of(first) == stem_of(second)) == (first == second)
    assert "/" not in stem_of(first)


def test_a_name_that_needs_no_change_is_kept():
    assert stem_of("driven-pendulum_2") == "driven-pendulum_2"
