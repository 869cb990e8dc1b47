"""Numbers are written with the digits that mean something."""

import pytest

from labrun.estimate import Estimate, rounded


@pytest.mark.parametrize(
    ("value", "ends", "told"),
    [
        (0.012, (0.011, 0.013), ("0.0120", "0.0110", "0.0130")),
        (1.7e-3, (1.7e-3, 0.299), ("0.002", "0.002", "0.30")),  # a size at the lower end is not nothing
        (1e-9, (-1.0, 1.0), ("0.0", "-1.0", "1.0")),
        (12028.0, (96.0, 19180.0), ("12000", "100", "19200")),  # nor are five digits known
    ],
)
def test_digits_are_those_that_the_interval_supports(value, ends, told):
    assert rounded(Estimate(value, ends, "rad/s")) == told
