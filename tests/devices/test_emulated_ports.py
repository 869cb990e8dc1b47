import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.devices.emulated_ports import FaultyWire
from labrun.devices.emulation import Faults
from labrun.runner import SimulatedClock

MESSAGES = [bytes([number] * 8) for number in range(1, 7)]


def wire(faults=None, baud=None):
    clock = SimulatedClock(100.0)
    return FaultyWire(clock, np.random.default_rng(1), Faults(faults), baud), clock


def delivered(line, clock, until_s=1e6):
    return [message for message, _ in line.due(clock.now() + until_s)]


def test_without_a_fault_every_message_arrives_as_it_was_and_in_order():
    line, clock = wire()
    for message in MESSAGES:
        line.put(message, "driver")
    assert line.due(clock.now()) == [(message, "driver") for message in MESSAGES]


def test_a_message_takes_as_long_as_its_bytes_at_this_baud_rate():
    line, _clock = wire(baud=19_200)
    line.put(bytes(16), None)
    line.put(bytes(16), None)
    wire_s = 16 * 10 / 19_200
    assert line.next_s() == pytest.approx(100.0 + wire_s)
    assert line.due(100.0 + 0.99 * wire_s) == []
    assert len(line.due(100.0 + 1.01 * wire_s)) == 1
    assert line.next_s() == pytest.approx(100.0 + 2 * wire_s)


def test_silence_lets_nothing_through_until_it_ends():
    line, clock = wire({"silence": True})
    line.put(MESSAGES[0], None)
    line.faults.set("silence", None)
    line.put(MESSAGES[1], None)
    assert delivered(line, clock) == [MESSAGES[1]]


def test_a_late_message_arrives_later():
    line, _clock = wire({"late": 0.5})
    line.put(MESSAGES[0], None)
    assert line.due(100.49) == []
    assert len(line.due(100.51)) == 1


def test_a_corrupt_message_differs_in_one_bit_and_the_next_is_whole():
    line, clock = wire({"corrupt": 1})
    line.put(MESSAGES[0], None)
    line.put(MESSAGES[1], None)
    spoiled, whole = delivered(line, clock)
    differing = int.from_bytes(spoiled, "big") ^ int.from_bytes(MESSAGES[0], "big")
    assert differing.bit_count() == 1
    assert whole == MESSAGES[1]


@pytest.mark.parametrize(("fault", "length"), [("half-frame", 4), ("truncate", 7)])
def test_a_cut_message_lacks_its_end(fault, length):
    line, clock = wire({fault: 1})
    line.put(MESSAGES[0], None)
    assert delivered(line, clock) == [MESSAGES[0][:length]]


def test_a_duplicated_message_arrives_twice_and_a_reordered_one_after_its_successor():
    line, clock = wire({"duplicate": 1})
    line.put(MESSAGES[0], None)
    line.put(MESSAGES[1], None)
    assert delivered(line, clock) == [MESSAGES[0], MESSAGES[0], MESSAGES[1]]
    line, clock = wire({"reorder": 1})
    for message in MESSAGES[:3]:
        line.put(message, None)
    assert delivered(line, clock) == [MESSAGES[1], MESSAGES[0], MESSAGES[2]]


def test_messages_are_dropped_at_the_share_asked_for():
    line, clock = wire({"drop": 0.3})
    for _ in range(2000):
        line.put(MESSAGES[0], None)
    # 3.3 standard deviations of a binomial with 2000 draws
    assert len(delivered(line, clock)) == pytest.approx(1400, abs=68)


@given(st.lists(st.binary(min_size=1, max_size=20), min_size=1, max_size=12), st.integers(2, 4))
def test_pieces_and_lumps_change_where_a_stream_is_cut_but_not_its_bytes(messages, lump):
    for faults in ({"fragment": True}, {"coalesce": lump}):
        line, clock = wire(faults)
        for message in messages:
            line.put(message, None)
        arrived = b"".join(delivered(line, clock))
        assert b"".join(messages).startswith(arrived)
        left = len(messages) % lump if "coalesce" in faults else 0
        assert arrived == b"".join(messages[: len(messages) - left])


@given(st.integers(1, 9))
def test_a_counted_fault_strikes_as_often_as_it_says(times):
    faults = Faults({"corrupt": times})
    assert sum(faults.take("corrupt") for _ in range(20)) == times


def test_a_fault_set_to_true_strikes_until_it_is_cleared():
    faults = Faults({"corrupt": True})
    assert all(faults.take("corrupt") for _ in range(20))
    faults.set("corrupt", None)
    assert not faults.take("corrupt")
