"""Frames in order: what a network does to datagrams is undone as far as it can be, and counted where it cannot."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.optitrack.frame import Frame
from labrun_plugins.optitrack.stream import FrameOrder

RATE_HZ = 100.0
HOLD_S = 0.015


def _frame(number: int) -> Frame:
    wrapped = (number + 2**31) % 2**32 - 2**31
    return Frame(wrapped, (), (), 0.0, None, None, None, None, 0)


def _run(events, order=None):
    """Put (number, exposed, host) in; return what came out, the last flushed long after."""
    order = order or FrameOrder(RATE_HZ)
    out = []
    host_s = 0.0
    for number, exposed_s, host_s in events:
        out += order.put(_frame(number), exposed_s, host_s)
    out += order.flush(max((host_s for _, _, host_s in events), default=0.0) + 1.0)
    return order, out


def _plain(numbers, clock=lambda number: number / RATE_HZ):
    return [(number, clock(number), clock(number) + 0.005) for number in numbers]


def test_frames_in_order_are_handed_on_at_once():
    order = FrameOrder(RATE_HZ)
    for number, exposed_s, host_s in _plain(range(10, 20)):
        (arrival,) = order.put(_frame(number), exposed_s, host_s)
        assert (arrival.frame.number, arrival.lost, arrival.host_s) == (number, 0, host_s)


def test_a_gap_is_counted_once_it_is_clear_that_nothing_comes():
    _, out = _run(_plain([1, 2, 6, 7, 8, 9, 10]))
    assert [(a.frame.number, a.lost) for a in out] == [
        (1, 0),
        (2, 0),
        (6, 3),
        (7, 0),
        (8, 0),
        (9, 0),
        (10, 0),
    ]


def test_a_gap_holds_frames_back_for_some_ten_milliseconds_only():
    order = FrameOrder(RATE_HZ)
    order.put(_frame(1), 0.01, 0.01)
    assert order.put(_frame(3), 0.03, 0.03) == []
    assert order.flush(0.03 + 0.9 * HOLD_S) == []
    assert [a.lost for a in order.flush(0.03 + 1.1 * HOLD_S)] == [1]


def test_a_straggler_is_put_back_and_receive_times_do_not_run_backwards():
    events = [(1, 0.01, 0.015), (3, 0.03, 0.035), (2, 0.02, 0.036), (4, 0.04, 0.045)]
    order, out = _run(events)
    assert [(a.frame.number, a.lost) for a in out] == [(1, 0), (2, 0), (3, 0), (4, 0)]
    assert [a.host_s for a in out] == [0.015, 0.036, 0.036, 0.045]
    assert order.stale == 0


def test_a_repeated_frame_is_handed_on_once():
    order, out = _run(_plain([1, 1, 2, 4, 4, 2, 5, 6, 7]))
    assert [a.frame.number for a in out] == [1, 2, 4, 5, 6, 7]
    assert order.stale == 3


def test_the_count_wraps_without_a_gap():
    start = 2**31 - 3
    order, out = _run([(start + i, i / RATE_HZ, i / RATE_HZ) for i in range(6)])
    assert [a.frame.number for a in out] == [
        2**31 - 3,
        2**31 - 2,
        2**31 - 1,
        -(2**31),
        -(2**31) + 1,
        -(2**31) + 2,
    ]
    assert sum(a.lost for a in out) == 0
    assert order.restarts == 0


def test_a_new_count_is_noticed_and_the_clock_tells_what_was_lost():
    before = _plain(range(500, 510))
    after = [(number, 5.15 + number / RATE_HZ, 5.16 + number / RATE_HZ) for number in range(5)]
    order, out = _run(before + after)
    assert order.restarts == 1
    assert [a.frame.number for a in out] == [*range(500, 510), *range(5)]
    assert [a.lost for a in out] == [0] * 10 + [5] + [0] * 4


def test_a_new_count_of_a_new_clock_loses_nothing_that_anyone_could_count():
    order, out = _run(_plain(range(5000, 5005)) + [(n, n / RATE_HZ, 60 + n / RATE_HZ) for n in range(5)])
    assert order.restarts == 1
    assert sum(a.lost for a in out) == 0
    assert [a.frame.number for a in out][-5:] == [0, 1, 2, 3, 4]


def test_a_server_that_begins_anew_after_a_few_frames_is_noticed_by_its_clock():
    before = [(n, 300 + n / RATE_HZ, n / RATE_HZ) for n in range(20)]
    order, out = _run(before + [(n, n / RATE_HZ, 0.3 + n / RATE_HZ) for n in range(5)])
    assert order.restarts == 1
    assert order.stale == 0
    assert [a.frame.number for a in out] == [*range(20), *range(5)]


def test_a_single_number_from_nowhere_is_dropped():
    order, out = _run([*_plain(range(5)), (2**30, 0.05, 0.055), *_plain(range(6, 10))])
    assert order.restarts == 0
    assert [a.frame.number for a in out] == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert sum(a.lost for a in out) == 1


@settings(max_examples=200, deadline=None)
@given(
    start=st.integers(-(2**31), 2**31 - 1),
    fates=st.lists(
        st.sampled_from(["comes", "comes", "comes", "late", "lost", "twice"]), min_size=2, max_size=80
    ),
)
def test_whatever_a_network_does_every_frame_is_handed_on_once_in_order_or_counted(start, fates):
    arriving = []
    for step, fate in enumerate(fates):
        exposed_s = step / RATE_HZ
        if fate == "lost":
            continue
        arriving.append((exposed_s + (0.012 if fate == "late" else 0.0), step, exposed_s))
        if fate == "twice":
            arriving.append((exposed_s + 0.004, step, exposed_s))
    arriving.sort()
    if not arriving:
        return
    order, out = _run([(start + step, exposed_s, host_s) for host_s, step, exposed_s in arriving])
    steps = [round(a.exposed_s * RATE_HZ) for a in out]
    first = arriving[0][1]
    assert steps == sorted({step for _, step, _ in arriving if step >= first})
    assert sum(a.lost for a in out) == steps[-1] - steps[0] + 1 - len(steps)
    assert [a.host_s for a in out] == sorted(a.host_s for a in out)
    assert order.restarts == 0


@settings(max_examples=200, deadline=None)
@given(
    events=st.lists(
        st.tuples(
            st.integers(-(2**31), 2**31 - 1) | st.integers(0, 30),
            st.floats(0, 1e12),
            st.floats(0, 1e3),
        ),
        max_size=60,
    )
)
def test_no_numbers_and_no_times_upset_it(events):
    order, out = _run(events)
    assert len(out) + order.stale <= len(events)
    assert all(a.lost >= 0 for a in out)
    assert order.flush(math.inf) == []
