"""Packets: golden vectors both ways on both sides of the wire, and whatever noise may bring."""

import pytest
from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS
from dynamixel_vectors import FAST_STATUSES, INSTRUCTIONS, STATUSES, MemoryPort, frame
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.dynamixel import emulated_packets as wire
from labrun_plugins.dynamixel.codec import StatusParser, crc16, split_fast, stuff, unstuff
from labrun_plugins.dynamixel.sdk import HardenedHandler

TRICKY = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0xFE, 0x01]), max_size=24).map(bytes)
ANYTHING = st.one_of(st.binary(max_size=40), TRICKY)
STATUS = st.builds(
    wire.status_packet, st.integers(0, 252), st.sampled_from([0, 0x80, 7, 4]), st.one_of(ANYTHING)
)

INSTRUCTION = st.builds(wire.instruction_packet, st.integers(0, 252), st.just(3), ANYTHING)


def _names(vectors):
    return [vector[0] for vector in vectors]


def _from_library(identity, code, parameters):
    """Have the vendor's library, hardened, build a packet by the function it has for it."""
    port, handler = MemoryPort(), HardenedHandler()
    given_ = list(parameters)
    address, length = int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
    if identity == 254 and code in (1, 3):
        packet = [0] * (10 + len(given_))
        packet[4:8] = [identity, len(given_) + 3, 0, code]
        packet[8 : 8 + len(given_)] = given_
        handler.txPacket(port, packet)
        return port.sent[0]
    build = {
        0x01: lambda: handler.ping(port, identity),
        0x02: lambda: handler.readTx(port, identity, address, length),
        0x03: lambda: handler.writeTxOnly(port, identity, address, len(given_) - 2, given_[2:]),
        0x04: lambda: handler.regWriteTxOnly(port, identity, address, len(given_) - 2, given_[2:]),
        0x05: lambda: handler.action(port, identity),
        0x08: lambda: handler.reboot(port, identity),
        0x10: lambda: handler.clearMultiTurn(port, identity),
        0x82: lambda: handler.syncReadTx(port, address, length, given_[4:], len(given_) - 4, False),
        0x8A: lambda: handler.syncReadTx(port, address, length, given_[4:], len(given_) - 4, True),
        0x83: lambda: handler.syncWriteTxOnly(port, address, length, given_[4:], len(given_) - 4),
        0x92: lambda: handler.bulkReadTx(port, given_, len(given_), False),
        0x9A: lambda: handler.bulkReadTx(port, given_, len(given_), True),
        0x93: lambda: handler.bulkWriteTxOnly(port, given_, len(given_)),
    }
    build[code]()
    return port.sent[0]


@pytest.mark.parametrize(
    ("_name", "identity", "code", "parameters", "text"), INSTRUCTIONS, ids=_names(INSTRUCTIONS)
)
def test_the_host_sends_the_golden_instructions(_name, identity, code, parameters, text):
    assert _from_library(identity, code, parameters) == frame(text)


@pytest.mark.parametrize(
    ("_name", "identity", "code", "parameters", "text"), INSTRUCTIONS, ids=_names(INSTRUCTIONS)
)
def test_the_servo_understands_the_golden_instructions(_name, identity, code, parameters, text):
    assert wire.InstructionReader().feed(frame(text)) == [wire.Instruction(identity, code, parameters)]
    assert wire.instruction_packet(identity, code, parameters) == frame(text)


def test_the_fast_bulk_read_of_the_manual_has_a_wrong_check_sum_and_is_not_believed():
    printed = frame("FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 20 F2")
    (instruction,) = wire.InstructionReader().feed(printed)
    assert not instruction.sound


@pytest.mark.parametrize(("_name", "identity", "error", "data", "text"), STATUSES, ids=_names(STATUSES))
def test_the_servo_sends_the_golden_answers(_name, identity, error, data, text):
    assert wire.status_packet(identity, error, data) == frame(text)


@pytest.mark.parametrize(("_name", "identity", "error", "data", "text"), STATUSES, ids=_names(STATUSES))
def test_the_host_understands_the_golden_answers(_name, identity, error, data, text):
    (status,) = StatusParser().feed(frame(text))
    assert (status.id, status.error, status.data) == (identity, error, data)
    assert status.alert == bool(error & 0x80)
    assert status.refusal == error & 0x7F


@pytest.mark.parametrize(("_name", "blocks", "text"), FAST_STATUSES, ids=_names(FAST_STATUSES))
def test_fast_answers_are_the_golden_ones_and_are_found_whole(_name, blocks, text):
    assert wire.fast_status_packet(blocks) == frame(text)
    (status,) = StatusParser().feed(frame(text))
    assert status.id == 254


def test_the_host_takes_a_fast_answer_apart_and_keeps_each_servos_error():
    blocks = [(3, 0, b"\xff\xff\xfd\x00"), (7, 0x80, b"\x01\x02\x03\x04")]
    (status,) = StatusParser().feed(wire.fast_status_packet(blocks))
    fast = split_fast(status, [3, 7], 4)
    assert {i: (s.error, s.data) for i, s in fast.items()} == {i: (e, d) for i, e, d in blocks}
    assert split_fast(status, [7, 3], 4) is None
    assert split_fast(status, [3, 7], 2) is None
    assert split_fast(status, [3], 4) is None


def test_a_fast_answer_with_one_wrong_check_sum_inside_is_not_believed():
    packet = bytearray(wire.fast_status_packet([(3, 0, b"\x01\x02"), (7, 0, b"\x03\x04")]))
    packet[12] ^= 0x40  # the inner check sum; the outer one is made to fit again
    packet[-2:] = crc16(bytes(packet[:-2])).to_bytes(2, "little")
    (status,) = StatusParser().feed(bytes(packet))
    assert split_fast(status, [3, 7], 2) is None


@given(ANYTHING)
def test_stuffing_is_taken_back_exactly_by_both_sides(body):
    stuffed = stuff(body)
    assert b"\xff\xff\xfd\x00" not in stuffed
    assert unstuff(stuffed) == body
    (status,) = StatusParser().feed(wire.status_packet(9, 0, body))
    assert status.data == body
    (instruction,) = wire.InstructionReader().feed(wire.instruction_packet(9, 3, body))
    assert instruction.parameters == body


@given(st.binary(max_size=60))
def test_both_sides_compute_the_same_check_sum(data):
    assert crc16(data) == wire.checksum(data)


@given(st.lists(st.one_of(STATUS, INSTRUCTION, ANYTHING), max_size=6), st.data())
def test_how_answers_are_cut_into_pieces_does_not_matter(parts, data):
    stream = b"".join(parts)
    whole = [(s.id, s.error, s.data) for s in StatusParser().feed(stream)]
    parser, result, rest = StatusParser(), [], stream
    while rest:
        size = data.draw(st.integers(1, max(1, len(rest))))
        result += [(s.id, s.error, s.data) for s in parser.feed(rest[:size])]
        rest = rest[size:]
    assert result == whole


@given(
    st.lists(
        st.one_of(st.builds(wire.instruction_packet, st.integers(0, 252), st.just(3), ANYTHING), ANYTHING),
        max_size=5,
    )
)
def test_a_servo_takes_any_bytes(parts):
    reader = wire.InstructionReader()
    for part in parts:
        for instruction in reader.feed(part):
            assert 0 <= instruction.id <= 255
    assert len(reader._packet) < 1100


@given(st.binary(max_size=400))
def test_the_host_takes_any_bytes_in_bounded_memory(noise):
    parser = StatusParser()
    for _ in range(5):
        parser.feed(noise)
        assert parser.pending < 1100


@given(st.integers(0, 252), ANYTHING, st.integers(7, 60), st.integers(1, 255))
def test_an_answer_with_a_changed_payload_is_rejected_by_the_host(identity, body, position, change):
    packet = bytearray(wire.status_packet(identity, 0, body))
    index = 7 + (position - 7) % (len(packet) - 7)
    packet[index] ^= change
    assert StatusParser().feed(bytes(packet)) == []


@given(st.integers(0, 252), ANYTHING, st.integers(0, 60), st.integers(1, 255))
def test_an_instruction_with_a_changed_payload_is_not_carried_out(identity, body, position, change):
    packet = bytearray(wire.instruction_packet(identity, 3, body))
    index = 7 + position % (len(packet) - 7)
    packet[index] ^= change
    assert not [i for i in wire.InstructionReader().feed(bytes(packet)) if i.sound]


def test_the_echo_of_the_hosts_own_words_is_passed_over():
    echo = wire.instruction_packet(1, 2, b"\x84\x00\x04\x00")
    (status,) = StatusParser().feed(echo + wire.status_packet(1, 0, b"\x01\x02\x03\x04"))
    assert status.data == b"\x01\x02\x03\x04"


@pytest.mark.parametrize("length", [1, 2, 4])
def test_a_refusal_is_not_taken_for_data(length):
    port = MemoryPort([wire.status_packet(1, 7)])
    data, result, error = HardenedHandler().readTxRx(port, 1, 132, length)
    assert (data, result, error) == ([], COMM_RX_CORRUPT, 7)


def test_an_answer_without_room_for_its_error_byte_is_none_even_with_a_right_check_sum():
    parser = StatusParser()
    short = bytes.fromhex("FF FF FD 00 01 03 00 55")
    assert parser.feed(short + crc16(short).to_bytes(2, "little")) == []
    assert parser.damaged == 1
    (result,) = parser.feed(bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C"))
    assert (result.id, result.error, result.data) == (1, 0, b"")


def test_an_alert_comes_with_its_data():
    port = MemoryPort([wire.status_packet(1, 0x80, b"\x20")])
    assert HardenedHandler().readTxRx(port, 1, 70, 1) == ([0x20], COMM_SUCCESS, 0x80)


def test_the_late_answer_to_an_earlier_question_is_passed_over():
    late, own = wire.status_packet(1, 0, b"\x01\x02\x03\x04"), wire.status_packet(1, 0, b"\x07")
    port = MemoryPort([late + own[:5], own[5:]])
    assert HardenedHandler().readTxRx(port, 1, 70, 1) == ([7], COMM_SUCCESS, 0)


def test_another_servos_answer_is_passed_over_and_remembered():
    port, handler = MemoryPort([wire.status_packet(6, 0, b"\x07")]), HardenedHandler()
    assert handler.readTxRx(port, 5, 70, 1) == ([], COMM_RX_TIMEOUT, 0)
    assert handler.strangers == {6}


def test_the_librarys_own_receiver_works_on_the_hardened_one():
    handler, data = HardenedHandler(), b"\xff\xff\xfd\xff\xfd\xfd"
    packet, result = handler.rxPacket(MemoryPort([wire.status_packet(1, 0, data)]), False)
    assert result == COMM_SUCCESS
    assert bytes(packet[9:-2]) == data
    assert handler.rxPacket(MemoryPort([b"\xff\xff\xfd\x00\x01"]), False)[1] == COMM_RX_CORRUPT


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00]), min_size=1, max_size=12))
@settings(max_examples=200)
def test_what_the_library_sends_is_stuffed(payload):
    port = MemoryPort()
    HardenedHandler().writeTxOnly(port, 1, 116, len(payload), payload)
    (instruction,) = wire.InstructionReader().feed(port.sent[0])
    assert instruction.sound
    assert instruction.parameters == b"\x74\x00" + bytes(payload)
