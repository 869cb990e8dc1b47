"""Lines of the stage: the golden ones of the protocol page both ways, HX711 values, counters, and garbage."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.labline.board import opened, sealed
from labrun_plugins.labline.codec import LineParser, decode, encode
from labrun_plugins.linear_stage.reception import (
    DeviceClock,
    Flags,
    SampleCounter,
    ahead,
    is_saturated,
    limit_arguments,
    move_arguments,
    parse_sample,
    parse_state,
)

REQUESTS = {
    b"$1,HOME*5E91\n": (1, "HOME"),
    b"$2,MV,12.500,1.000*8CEE\n": (2, "MV", *move_arguments(12.5, 1.0)),
    b"$3,VEL,-0.500*18DB\n": (3, "VEL", "-0.500"),
    b"$4,STR,80*B7C9\n": (4, "STR", "80"),
}
CLIPPED = b"$0,S,1042,123456789,1.2345,-8388608,0*FFFB\n"
GOOD = b"$0,S,1043,123469289,1.2470,83412,0*E17F\n"


@pytest.mark.parametrize("wire", REQUESTS)
def test_requests_are_those_of_the_page_and_the_board_reads_them(wire):
    assert encode(*REQUESTS[wire]) == wire
    assert opened(wire[:-1]) == ",".join(str(field) for field in REQUESTS[wire]).encode()


@pytest.mark.parametrize("wire", [CLIPPED, GOOD])
def test_the_board_writes_the_samples_of_the_page(wire):
    assert sealed(wire[1:-6].decode()) == wire


def test_the_driver_reads_the_samples_of_the_page():
    line = decode(GOOD[:-1])
    assert line is not None and line.word == "S"
    sample = parse_sample(line.fields[1:])
    assert (sample.n, sample.micros, sample.position_mm, sample.counts) == (1043, 123469289, 1.247, 83412)
    assert not sample.saturated


def test_a_clipped_count_is_saturated_even_where_the_board_has_not_set_the_flag():
    sample = parse_sample(decode(CLIPPED[:-1]).fields[1:])
    assert sample.flags == Flags(0)
    assert sample.saturated


@pytest.mark.parametrize(
    ("counts", "saturated"), [(1, False), (-1, False), (8388607, True), (-8388608, True), (83412, False)]
)
def test_counts_at_either_end_of_24_bits_are_saturated(counts, saturated):
    assert is_saturated(counts) is saturated


@given(st.floats(-1000, 1000), st.floats(1e-7, 10))
def test_a_move_never_stands_still_and_never_exceeds_its_speed_by_a_thousandth(position_mm, speed_mm_s):
    position, speed = move_arguments(position_mm, speed_mm_s)
    assert abs(float(position) - position_mm) <= 0.0005 + 1e-9
    assert float(speed) > 0
    assert float(speed) <= max(speed_mm_s, 0.0) + 0.001


@given(st.floats(0, 50), st.floats(51, 100))
def test_limits_of_travel_are_rounded_inwards(low_mm, high_mm):
    low, high, counts = limit_arguments(low_mm, high_mm, 1000)
    assert float(low) >= low_mm - 1e-8
    assert float(high) <= high_mm + 1e-8
    assert counts == "1000"


@given(st.lists(st.text(max_size=15), max_size=8))
def test_no_fields_make_the_parsers_raise(fields):
    for parse in (parse_sample, parse_state):
        result = parse(fields)
        if result is not None:
            assert -0x800000 <= result.counts <= 0x7FFFFF
            assert math.isfinite(result.position_mm)


@pytest.mark.parametrize(
    "fields",
    [
        ("1", "2", "3.0", "4"),
        ("1", "2", "3.0", "4", "0", "0"),
        ("-1", "2", "3.0", "4", "0"),
        (str(2**32), "2", "3.0", "4", "0"),
        ("1", "2", "nan", "4", "0"),
        ("1", "2", "1e3", "4", "0"),
        ("1", "2", "3.0", "8388608", "0"),
        ("1", "2", "3.0", "4", "256"),
        ("1", "2", ".", "4", "0"),
        ("1", "2", "٣.0", "4", "0"),
    ],
)
def test_what_is_no_sample_is_none(fields):
    assert parse_sample(fields) is None


@given(
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(-(2**23), 2**23 - 1)), min_size=1, max_size=20),
    st.data(),
)
def test_a_flipped_bit_makes_no_other_sample_and_pieces_make_no_difference(values, data):
    wires = [sealed(f"0,S,{n},{n},1.0000,{counts},2") for n, counts in values]
    stream = bytearray(b"".join(wires))
    index = data.draw(st.integers(0, len(stream) - 1))
    stream[index] ^= 1 << data.draw(st.integers(0, 7))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    parser, whole = LineParser(), LineParser()
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    lines = [line for piece in pieces for line in parser.feed(bytes(piece))]
    assert lines == whole.feed(bytes(stream))
    sent = {decode(wire[:-1]).fields for wire in wires}
    assert {line.fields for line in lines} <= sent
    assert len(lines) >= len(wires) - 2


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 1000), max_size=50))
def test_gaps_in_the_numbers_are_lost_samples_whatever_the_count_wraps_to(first, steps):
    counter = SampleCounter()
    assert counter.take(first) == 0
    n = first
    for step in steps:
        n = (n + step) % 2**32
        assert counter.take(n) == step - 1


def test_a_duplicate_and_a_straggler_are_not_taken_again():
    counter = SampleCounter()
    assert [counter.take(n) for n in (10, 11, 13, 12, 13, 14)] == [0, 0, 1, None, None, 0]
    assert counter.repeated == 2
    assert not counter.restarted


def test_numbers_that_begin_anew_are_a_restart_and_stragglers_are_not():
    counter = SampleCounter()
    for n in range(1000, 1100):
        counter.take(n)
    for n in (1095, 1096, 1090, 1097, 1080, 1081, 1082, 1083):
        assert counter.take(n) is None
    assert not counter.restarted
    for n in range(1, 9):
        counter.take(n)
    assert counter.restarted


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 2**30), min_size=1, max_size=20))
def test_device_time_goes_on_through_the_wrap(first, steps):
    clock = DeviceClock()
    start_s = clock.time_s(first)
    assert start_s == pytest.approx(first * 1e-6)
    at, passed = first, 0
    for step in steps:
        at, passed = (at + step) % 2**32, passed + step
        assert clock.time_s(at) - start_s == pytest.approx(passed * 1e-6)


def test_ahead_is_signed():
    assert ahead(1, 2**32 - 1) == 2
    assert ahead(2**32 - 1, 1) == -2
