"""Bytes of the Net F/T box: golden vectors both ways, and whatever else may arrive."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.ati_netft import codec

RECORD_ONE = bytes.fromhex(
    "00 00 00 01 00 00 12 67 00 00 00 00 00 0F 42 40 FF E1 7B 80 00 35 67 E0 00 00 03 E8 FF FF FE 0C 00 00 00 FA"
)
RECORD_TWO = bytes.fromhex("00 00 00 02 00 00 12 68 80 01 00 00") + bytes(24)
CALIBRATION = bytes.fromhex("12 34 02 04 00 0F 42 40 00 00 03 E8 00 03 00 03 00 09 00 3D 00 3D 00 3D")


@pytest.mark.parametrize(
    ("command", "count", "wire"),
    [
        (codec.STOP, 0, "12 34 00 00 00 00 00 00"),
        (codec.STREAM, 0, "12 34 00 02 00 00 00 00"),
        (codec.STREAM, 1, "12 34 00 02 00 00 00 01"),
        (codec.BUFFERED, 0, "12 34 00 03 00 00 00 00"),
        (codec.RESET_LATCH, 0, "12 34 00 41 00 00 00 00"),
        (codec.BIAS, 0, "12 34 00 42 00 00 00 00"),
    ],
)
def test_requests_are_those_of_the_manual(command, count, wire):
    assert codec.request(command, count) == bytes.fromhex(wire)


def test_a_healthy_record_is_read_as_the_manual_says():
    record = codec.decode(RECORD_ONE)
    assert record is not None
    assert (int(record["rdt_sequence"][0]), int(record["ft_sequence"][0])) == (1, 4711)
    assert int(record["status"][0]) == 0
    assert record["counts"][0].tolist() == [1_000_000, -2_000_000, 3_500_000, 1000, -500, 250]


def test_a_record_with_a_tripped_condition_is_read_and_may_be_used():
    record = codec.decode(RECORD_TWO)
    assert record is not None
    assert (int(record["rdt_sequence"][0]), int(record["ft_sequence"][0])) == (2, 4712)
    assert int(record["status"][0]) == 0x8001_0000
    assert not codec.is_serious(codec.status_of(record)).any()
    assert codec.words(0x8001_0000) == "a monitor condition tripped (status 80010000)"


def test_the_calibration_request_and_its_answer_are_those_of_the_manual():
    assert codec.calibration_request() == b"\x01" + bytes(19)
    assert codec.read_ft_request() == bytes(20)
    answer = codec.decode_calibration(CALIBRATION)
    assert answer == codec.CalibrationAnswer(2, 4, 1_000_000, 1000, (3, 3, 9, 61, 61, 61))


def test_a_reading_over_tcp_has_the_upper_half_of_the_status():
    wire = struct.pack(">HH6h", 0x1234, 0x8002, 1, -2, 3, -4, 5, -6)
    assert codec.decode_reading(wire) == codec.Reading(0x8002_0000, (1, -2, 3, -4, 5, -6))


@pytest.mark.parametrize(
    ("word", "serious", "saturated"),
    [
        (0x0000_0000, False, False),
        (0x8001_0000, False, False),
        (0x8002_0000, False, True),
        (0x8003_0000, False, True),
        (0x8000_0000, True, False),
        (0x9000_0000, True, False),
        (0x8001_0004, True, False),
        (0x9002_0000, True, True),
    ],
)
def test_only_saturation_and_conditions_are_no_reason_to_discard_a_sample(word, serious, saturated):
    words = np.array([word], dtype=np.int64)
    assert bool(codec.is_serious(words)[0]) is serious
    assert codec.is_serious_word(word) is serious
    assert bool(codec.is_saturated(words)[0]) is saturated


def test_every_bit_of_the_status_has_words_of_its_own():
    words = {codec.words(bit) for bit in codec.BITS}
    assert len(words) == len(codec.BITS) == 29
    assert "analogue board error" in codec.words(0x9000_0000)
    assert "stack error" in codec.words(0x8000_2004)
    assert "temperature" in codec.words(0x8000_2004)


@given(st.binary(max_size=1600))
def test_any_bytes_are_records_or_nothing(datagram):
    records = codec.decode(datagram)
    if len(datagram) in range(36, 1441, 36):
        assert records is not None
        assert records.tobytes() == datagram
    else:
        assert records is None


@given(st.lists(st.binary(max_size=1500), max_size=12))
def test_a_block_gives_what_its_datagrams_give_one_by_one(datagrams):
    slots = np.zeros((len(datagrams), 1500), np.uint8)
    for row, datagram in zip(slots, datagrams, strict=True):
        row[: len(datagram)] = np.frombuffer(datagram, np.uint8)
    length = np.array([len(datagram) for datagram in datagrams], dtype=np.int64)
    records, number, malformed = codec.decode_block(slots, length)
    alone = [codec.decode(datagram) for datagram in datagrams]
    assert malformed == sum(text is None for text in alone)
    assert records.tobytes() == b"".join(text.tobytes() for text in alone if text is not None)
    assert number.tolist() == [i for i, text in enumerate(alone) if text is not None for _ in text]


def test_a_block_does_not_change_when_its_buffer_is_used_again():
    slots = np.zeros((1, 1500), np.uint8)
    slots[0, :36] = np.frombuffer(RECORD_ONE, np.uint8)
    records, _, _ = codec.decode_block(slots, np.array([36]))
    slots[:] = 0xFF
    assert records.tobytes() == RECORD_ONE


@given(st.binary(max_size=60))
def test_answers_over_tcp_are_what_they_should_be_or_nothing(answer):
    calibration, reading = codec.decode_calibration(answer), codec.decode_reading(answer)
    assert (calibration is None) or (len(answer) == 24 and answer[:2] == b"\x12\x34")
    assert (reading is None) or (len(answer) == 16 and answer[:2] == b"\x12\x34")
