"""Order of the records: every one that arrived in time is handed over once, and every gap is counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.ati_netft.codec import RECORD
from labrun_plugins.ati_netft.reception import Sequencer

WRAP = 1 << 32


def records(numbers, *, first=1, first_ft=500, step=1):
    """Return the records of these numbers (from 0) of one stream."""
    made = np.zeros(len(numbers), RECORD)
    made["rdt_sequence"] = [(first + number) % WRAP for number in numbers]
    made["ft_sequence"] = [(first_ft + step * number) % WRAP for number in numbers]
    made["counts"][:, 0] = numbers
    return made


def fed(sequencer, made, sizes=()):
    """Feed records in blocks of these sizes; return what came out, settled."""
    blocks, start = [], 0
    for size in [*sizes, len(made)]:
        part = made[start : start + size]
        start += size
        blocks += sequencer.feed(part, np.arange(len(part), dtype=float))
    return [*blocks, sequencer.settle()]


def numbers_of(blocks):
    return [int(n) for block in blocks for n in block.records["counts"][:, 0]]


@given(
    st.integers(0, WRAP - 1),
    st.integers(0, WRAP - 1),
    st.sampled_from([1, 14, 7000]),
    st.lists(st.integers(0, 60), max_size=20),
    st.integers(1, 200),
)
def test_an_undisturbed_stream_comes_out_as_it_is_through_any_wrap_and_chunking(
    first, first_ft, step, sizes, n
):
    sequencer = Sequencer(step, 20)
    blocks = fed(sequencer, records(range(n), first=first, first_ft=first_ft, step=step), sizes)
    assert numbers_of(blocks) == list(range(n))
    ft = np.concatenate([block.ft_count for block in blocks])
    assert (np.diff(ft) == step).all()
    assert np.concatenate([block.position for block in blocks]).tolist() == list(range(n))
    assert (sequencer.counts.lost, sequencer.counts.repeated, sequencer.counts.restarts) == (0, 0, 0)


@settings(max_examples=200)
@given(st.data())
def test_losses_repeats_and_overtaking_within_the_patience_are_undone_and_counted(data):
    n = data.draw(st.integers(5, 120))
    patience = 20
    lost = data.draw(st.sets(st.integers(1, n - 2), max_size=n // 3))
    delays = data.draw(st.lists(st.integers(0, 8), min_size=n, max_size=n))
    delays[0] = 0
    order = sorted((i + delays[i], i) for i in range(n) if i not in lost)
    arrived = [i for _, i in order]
    for i in data.draw(st.lists(st.sampled_from(arrived), max_size=5)):
        arrived.insert(min(arrived.index(i) + data.draw(st.integers(1, 6)), len(arrived)), i)
    sizes = data.draw(st.lists(st.integers(0, 30), max_size=8))
    sequencer = Sequencer(14, patience)
    start = data.draw(st.sampled_from([1, WRAP - 30]))
    blocks = fed(sequencer, records(arrived, first=start, first_ft=WRAP - 200, step=14), sizes)
    assert numbers_of(blocks) == sorted(set(arrived))
    first, last = min(arrived), max(arrived)
    assert sequencer.counts.lost == len([i for i in lost if first < i < last])
    assert sequencer.counts.repeated == len(arrived) - len(set(arrived))
    assert sequencer.counts.restarts == 0


def test_a_missing_record_holds_up_the_others_for_the_patience_only():
    sequencer = Sequencer(1, 10)
    sequencer.feed(records([0, 1]), np.zeros(2))
    assert numbers_of(sequencer.feed(records([3, 4, 5]), np.zeros(3))) == []
    assert numbers_of(sequencer.feed(records(range(6, 14)), np.zeros(8))) == list(range(3, 14))
    assert sequencer.counts.lost == 1
    assert numbers_of(sequencer.feed(records([2]), np.zeros(1))) == []
    assert sequencer.counts.repeated == 1


@pytest.mark.parametrize("before", [3, 300, 20_000])
def test_a_stream_that_begins_anew_goes_on_with_its_gap_counted(before):
    sequencer = Sequencer(14, 20)
    blocks = fed(sequencer, records(range(before), step=14))
    anew = records(range(50), first=1, first_ft=500 + 14 * (before + 6), step=14)
    blocks += fed(sequencer, anew)
    assert numbers_of(blocks) == [*range(before), *range(50)]
    assert sequencer.counts.restarts == 1
    assert sequencer.counts.lost == 6
    positions = np.concatenate([block.position for block in blocks])
    assert positions[before] == before + 6
    assert (np.diff(np.concatenate([block.ft_count for block in blocks])) > 0).all()


def test_a_stream_that_begins_anew_within_one_block_is_cut_there():
    sequencer = Sequencer(1, 20)
    both = np.concatenate([records(range(30)), records(range(10), first=1, first_ft=530)])
    blocks = fed(sequencer, both)
    assert numbers_of(blocks) == [*range(30), *range(10)]
    assert (sequencer.counts.restarts, sequencer.counts.lost) == (1, 0)


def test_a_box_that_counts_its_samples_anew_is_noticed_and_nothing_of_it_passed_on():
    sequencer = Sequencer(1, 20)
    fed(sequencer, records(range(100), first_ft=1_000_000))
    assert not sequencer.counts_anew
    passed = numbers_of(fed(sequencer, records(range(400), first=1, first_ft=1)))
    assert sequencer.counts_anew
    assert passed == []


def test_a_box_that_was_away_for_days_is_noticed_too():
    sequencer = Sequencer(1, 20)
    fed(sequencer, records(range(100), first_ft=3_000_000_000))
    fed(sequencer, records(range(5), first=1, first_ft=1))
    assert sequencer.counts_anew


NUMBER = st.one_of(st.integers(0, 60), st.integers(WRAP - 60, WRAP - 1), st.integers(0, WRAP - 1))


@given(st.lists(st.tuples(NUMBER, NUMBER), max_size=80), st.integers(1, 30))
def test_any_numbers_at_all_are_taken_without_growing_or_hanging(pairs, size):
    made = np.zeros(len(pairs), RECORD)
    made["rdt_sequence"] = [pair[0] for pair in pairs]
    made["ft_sequence"] = [pair[1] for pair in pairs]
    sequencer = Sequencer(1, 20)
    blocks = fed(sequencer, made, [size] * (len(pairs) // size))
    passed = sum(len(block) for block in blocks)
    taken = passed + sequencer.counts.repeated
    assert sequencer.counts.received == len(pairs)
    assert taken == len(pairs) or (sequencer.counts_anew and taken < len(pairs))
    positions = np.concatenate([block.position for block in blocks])
    assert (np.diff(positions) > 0).all()
