"""Lines of labline: the golden ones, both ways by both sides, and anything at all that a wire may bring."""

import itertools

import numpy as np
import pytest
from golden_lines import LINES
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.labline import board, codec

WORD = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="$*,"), max_size=8)


@pytest.mark.parametrize(("line", "seq", "fields"), LINES)
def test_the_host_reads_and_writes_the_golden_lines(line, seq, fields):
    assert codec.decode(line) == codec.Line(seq, fields)
    assert codec.encode(seq, *fields) == line + b"\n"


@pytest.mark.parametrize(("line", "seq", "fields"), LINES)
def test_the_board_reads_and_writes_the_golden_lines(line, seq, fields):
    body = ",".join((str(seq), *fields))
    assert board.opened(line) == body.encode()
    assert board.sealed(body) == line + b"\n"


def test_both_checksums_have_the_check_value():
    assert codec.checksum(b"123456789") == board.register(b"123456789") == 0x29B1


@given(st.binary(max_size=120))
def test_the_two_checksums_agree_on_anything(data):
    assert codec.checksum(data) == board.register(data)


@given(st.integers(0, 65_535), st.lists(WORD, min_size=1, max_size=6))
def test_what_one_side_writes_the_other_reads(seq, fields):
    line = codec.encode(seq, *fields)
    body = ",".join((str(seq), *fields))
    assert board.opened(line[:-1]) == body.encode()
    assert codec.decode(board.sealed(body)[:-1]) == codec.Line(seq, tuple(fields))


@pytest.mark.parametrize("wrong", [("A$",), ("A*",), ("A,B",), ("Ä",), ("A\n",), ()])
def test_what_cannot_stand_on_a_line_is_not_written(wrong):
    with pytest.raises(ValueError, match="cannot stand on a line"):
        codec.encode(1, *wrong)


def test_a_line_of_more_than_96_bytes_is_neither_written_nor_read():
    longest = codec.encode(1, "A" * (96 - len("$1,*1234\n")))
    assert len(longest) == 96
    assert codec.LineParser().feed(longest)
    with pytest.raises(ValueError, match="96 is the most"):
        codec.encode(1, "A" * (97 - len("$1,*1234\n")))
    parser = codec.LineParser()
    assert parser.feed(board.sealed("1," + "A" * 90)) == []
    assert parser.rejected == 1


def test_every_golden_line_with_one_or_two_flipped_bits_is_dropped():
    for line, seq, fields in LINES:
        message = codec.Line(seq, fields)
        for count in (1, 2):
            for bits in itertools.combinations(range(8 * len(line)), count):
                flipped = bytearray(line)
                for bit in bits:
                    flipped[bit // 8] ^= 1 << (bit % 8)
                assert codec.decode(bytes(flipped)) in {None, message}


def test_lines_with_three_flipped_bits_are_never_taken_for_something_else():
    # Sampled, not proven: checksums of 16 bits, written as digits, let about one in a million of these through.
    rng = np.random.default_rng(20)
    for _ in range(20_000):
        line, seq, fields = LINES[rng.integers(len(LINES))]
        flipped = bytearray(line)
        for bit in rng.choice(8 * len(line), size=3, replace=False):
            flipped[bit // 8] ^= 1 << (bit % 8)
        assert codec.decode(bytes(flipped)) in {None, codec.Line(seq, fields)}
        body = board.opened(bytes(flipped))
        assert body in {None, ",".join((str(seq), *fields)).encode()}


def test_the_parser_resumes_at_the_last_dollar_before_the_newline():
    parser = codec.LineParser()
    (line,) = parser.feed(b"$4,SV,15$5,OK,STOP*A7A5\n")
    assert line == codec.Line(5, ("OK", "STOP"))
    (line,) = parser.feed(b"x" * 300 + b"$5,OK,STOP*A7A5\n")
    assert line == codec.Line(5, ("OK", "STOP"))


@pytest.mark.parametrize(
    "line",
    [
        b"$5,OK,STOP*a7a5",
        b"$5,OK,STOP*A7A5\r",
        b"5,OK,STOP*A7A5",
        b"$5,OK,STOPA7A5",
        b"$*FFFF",
        b"$",
        b"",
        b"*",
    ],
)
def test_what_is_not_written_by_the_rules_is_dropped(line):
    assert codec.decode(line) is None


@pytest.mark.parametrize("body", ["66000,OK", "-1,OK", "x,OK", "7", "", "123456,OK"])
def test_a_right_checksum_does_not_make_a_line_of_nonsense(body):
    assert codec.decode(board.sealed(body)[:-1]) is None


PIECES = st.lists(
    st.one_of(
        st.sampled_from([line + b"\n" for line, _, _ in LINES]),
        st.binary(max_size=40),
        st.sampled_from([b"$", b"\n", b"*", b"$0,S,", b"\x00", b"$1,HELLO*7613"]),
    ),
    max_size=12,
)


@given(PIECES, st.lists(st.integers(0, 400), max_size=20))
def test_chunking_changes_nothing(pieces, cuts):
    data = b"".join(pieces)
    whole = codec.LineParser()
    at_once = whole.feed(data)
    parser = codec.LineParser()
    ends = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    in_parts = [line for a, b in itertools.pairwise(ends) for line in parser.feed(data[a:b])]
    assert in_parts == at_once
    assert (parser.accepted, parser.rejected) == (whole.accepted, whole.rejected)
    byte_by_byte = codec.LineParser()
    assert [line for byte in data for line in byte_by_byte.feed(bytes((byte,)))] == at_once


@given(PIECES)
def test_only_lines_with_a_right_checksum_come_out(pieces):
    data = b"".join(pieces)
    for line in codec.LineParser().feed(data):
        body = ",".join((str(line.seq), *line.fields))
        # The number may have been written with leading zeros; what counts is that these bytes were on the wire.
        assert any(board.sealed("0" * zeros + body) in data for zeros in range(5))


def test_a_flood_without_newlines_takes_no_memory():
    parser = codec.LineParser()
    for _ in range(100):
        assert parser.feed(b"$1,AAAA" * 1000) == []
    assert len(parser._rest) < 96
    assert parser.feed(b"\n$5,OK,STOP*A7A5\n") == [codec.Line(5, ("OK", "STOP"))]
