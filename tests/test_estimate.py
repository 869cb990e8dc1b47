"""Numbers are written with the digits that mean something."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.estimate import Estimate, outside_text, rounded


@pytest.mark.parametrize(
    ("value", "ends", "message"),
    [
        (0.012, (0.011, 0.013), ("0.0120", "0.0110", "0.0130")),
        (1.7e-3, (1.7e-3, 0.299), ("0.002", "0.002", "0.30")),  # a size at the lower end is not nothing
        (1e-9, (-1.0, 1.0), ("0.0", "-1.0", "1.0")),
        (12028.0, (96.0, 19180.0), ("12000", "100", "19200")),  # nor are five digits known
    ],
)
def test_digits_are_those_that_the_interval_supports(value, ends, message):
    assert rounded(Estimate(value, ends, "rad/s")) == message


@given(bound=st.floats(-1e6, 1e6), share=st.floats(1e-12, 1.0), above=st.booleans())
def test_a_value_outside_its_bounds_is_never_written_as_one_inside(bound, share, above):
    size = max(abs(bound), 1.0)
    value = bound + share * size if above else bound - share * size
    low, high = (bound - 10 * size, bound) if above else (bound, bound + 10 * size)
    if not low <= value <= high:
        assert not low <= float(outside_text(value, low, high)) <= high


def test_a_value_far_outside_is_written_short():
    assert outside_text(-0.25, -0.1, 0.95) == "-0.25"
    assert outside_text(-0.1000312345, -0.1, 0.95) == "-0.10003"
