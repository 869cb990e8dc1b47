"""What is written as TOML reads back the same, in the same order."""

import json
import tomllib

from hypothesis import given
from hypothesis import strategies as st

from labrun.toml import written_in_order

KEYS = st.one_of(st.sampled_from(["a", "b", "from", "max_x"]), st.text(max_size=4))
VALUES = st.recursive(
    st.one_of(st.integers(-(10**6), 10**6), st.floats(allow_nan=False), st.booleans(), st.text(max_size=8)),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(KEYS, inner, max_size=4)),
    max_leaves=12,
)


@given(table=st.dictionaries(KEYS, VALUES, max_size=5))
def test_a_table_reads_back_equal_with_all_keys_in_their_order(table):
    assert json.dumps(tomllib.loads(written_in_order(table))) == json.dumps(table)
