"""Options that several commands take."""

import pytest

from labrun.cli.options import seconds
from labrun.errors import RequestError


@pytest.mark.parametrize(
    ("text", "wanted"),
    [("10s", 10.0), ("10 s", 10.0), ("2.5", 2.5), ("2min", 120.0), ("0.5 min", 30.0), (None, None)],
)
def test_the_length_of_a_trial_is_a_number_with_or_without_its_unit(text, wanted):
    assert seconds(text) == wanted


@pytest.mark.parametrize("text", ["", "long", "10h", "mins"])
def test_what_is_no_time_is_refused_with_an_example(text):
    with pytest.raises(RequestError, match="invalid duration") as refused:
        seconds(text)
    assert "--cut 2min" in str(refused.value)
