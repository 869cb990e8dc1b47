"""Bytes of the FT300 in the driver and, independently, in the emulator: golden vectors, and anything at all."""

import numpy as np
import pytest
from ft300_vectors import ALIASING, READS, START, START_BY_06, STARTED, STREAM, WRENCH_COUNTS, WRENCH_REPLY
from hypothesis import example, given
from hypothesis import strategies as st
from labrun_plugins.robotiq_ft300 import codec
from labrun_plugins.robotiq_ft300.emulator import ModbusSlave, Refusal, checksum
from labrun_plugins.robotiq_ft300.emulator import stream_frame as emulated_frame
from labrun_plugins.robotiq_ft300.link import Registers
from labrun_plugins.robotiq_ft300.reception import GapCounter

from labrun.errors import DeviceError

counts = st.tuples(*[st.integers(-0x8000, 0x7FFF)] * 6)
without_header = st.binary(max_size=60).map(lambda data: data.replace(b"\x20", b"\x21"))


class HandClock:
    poll_s = 0.02

    def __init__(self):
        self.now_s = 0.0

    def now(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s


class ScriptedPort:
    """Answers a request with given portions of bytes; a read that finds none takes its 20 ms."""

    port = "scripted"

    def __init__(self, clock, *answers):
        self.clock = clock
        self.answers = list(answers)
        self.waiting = []
        self.written = []

    def discard_input(self):
        self.waiting = []

    def write(self, data):
        self.written.append(data)
        self.waiting = list(self.answers.pop(0)) if self.answers else []

    def read(self):
        if self.waiting:
            return self.waiting.pop(0)
        self.clock.sleep(0.02)
        return b""


def registers(*answers, tries=3):
    clock = HandClock()
    port = ScriptedPort(clock, *answers)
    return Registers("wrench", port, clock, 9, tries=tries), port


def slave(values=None, written=None):
    values = {} if values is None else values

    def value(register):
        if register not in values:
            raise Refusal(2)
        return values[register]

    def set_value(register, number):
        if written is None:
            raise Refusal(2)
        written.append((register, number))

    return ModbusSlave(9, value, set_value)


# --- golden vectors --------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", STREAM)
def test_both_sides_make_the_golden_frames_of_the_stream_and_the_driver_reads_them(row):
    assert codec.stream_frame(row) == STREAM[row]
    assert emulated_frame(row) == STREAM[row]
    assert codec.StreamParser().feed(STREAM[row]) == [(row, 0)]


def test_golden_counts_are_the_forces_and_torques_of_the_page():
    expected = [[12.34, -56.78, 100.0, 1.234, -0.567, 2.0]]
    np.testing.assert_allclose(codec.wrench([WRENCH_COUNTS]), expected, atol=1e-12)


@pytest.mark.parametrize(("asked", "request_frame"), READS.items())
def test_the_driver_asks_for_registers_in_the_golden_words(asked, request_frame):
    line, port = registers(tries=1)
    with pytest.raises(DeviceError, match="does not answer"):
        line.read(*asked)
    assert port.written == [request_frame]


@pytest.mark.parametrize(("asked", "request_frame"), READS.items())
def test_the_emulator_understands_the_golden_requests(asked, request_frame):
    address, count = asked
    taken = list(slave(dict.fromkeys(range(address, address + count), 7)).hear(request_frame))
    assert len(taken) == 1
    heard, answer = taken[0]
    assert heard == request_frame
    assert answer[:3] == bytes((9, 3, 2 * count))
    assert answer[3:-2] == b"\x00\x07" * count


def test_the_driver_reads_the_golden_reply_and_the_emulator_gives_it():
    line, _ = registers([WRENCH_REPLY])
    assert codec.signed(line.read(180, 6)) == WRENCH_COUNTS
    values = {180 + number: count & 0xFFFF for number, count in enumerate(WRENCH_COUNTS)}
    assert [answer for _, answer in slave(values).hear(READS[180, 6])] == [WRENCH_REPLY]


def test_the_stream_is_started_in_the_golden_words_and_acknowledged_in_them():
    line, port = registers([STARTED])
    line.write(410, [0x0200])
    assert port.written == [START]
    written = []
    assert [answer for _, answer in slave(written=written).hear(START)] == [STARTED]
    assert written == [(410, 0x0200)]


def test_the_emulator_takes_the_short_form_of_writing_too():
    written = []
    assert [answer for _, answer in slave(written=written).hear(START_BY_06)] == [START_BY_06]
    assert written == [(410, 0x0200)]


def test_the_checksums_of_both_sides_agree_with_pymodbus():
    from pymodbus.framer import FramerRTU

    rng = np.random.default_rng(5)
    for length in range(40):
        data = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        assert codec.crc16(data).to_bytes(2, "little") == checksum(data)
        assert checksum(data) == FramerRTU.compute_CRC(data).to_bytes(2, "big")


# --- the stream, whatever comes --------------------------------------------------------------------------


@given(st.lists(st.one_of(counts.map(codec.stream_frame), without_header), max_size=12))
@example([ALIASING, b"\x4e", ALIASING[3:], ALIASING])
def test_every_frame_among_foreign_bytes_is_found_in_its_order(parts):
    parser = codec.StreamParser()
    frames = [codec.stream_frame(frame.counts) for part in parts for frame in parser.feed(part)]
    whole = [part for part in parts if len(part) == 16 and part[:2] == codec.HEADER]
    assert frames == whole
    assert parser.frames == len(whole)


@given(st.lists(st.one_of(counts.map(emulated_frame), st.binary(max_size=40)), max_size=8), st.data())
def test_how_the_bytes_are_cut_into_portions_changes_nothing(parts, data):
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    at_once = codec.StreamParser()
    portions = codec.StreamParser()
    expected = [frame.counts for frame in at_once.feed(stream)]
    results = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        results += [frame.counts for frame in portions.feed(stream[begin:end])]
        assert len(portions._kept) < codec.FRAME_BYTES
    assert results == expected
    assert portions.crc_errors == at_once.crc_errors


@given(st.lists(counts, min_size=1, max_size=6), st.data())
def test_a_frame_with_up_to_16_neighbouring_bits_changed_is_not_accepted(rows, data):
    stream = b"".join(codec.stream_frame(row) for row in rows)
    hit = data.draw(st.integers(0, len(rows) - 1))
    begin = data.draw(st.integers(16 * 8 * hit, 16 * 8 * hit + 112))
    burst = data.draw(st.integers(1, 0xFFFF))
    number = int.from_bytes(stream, "little") ^ (burst << begin)
    changed = number.to_bytes(len(stream), "little")
    spoilt = {index // 16 for index in range(len(stream)) if changed[index] != stream[index]}
    # The CRC of Modbus finds every burst of up to 16 bits.
    parser = codec.StreamParser()
    accepted = [len(stream) - 16 - frame.later_bytes for frame in parser.feed(changed)]
    assert not {16 * number for number in spoilt} & set(accepted)


@given(st.binary(max_size=400))
def test_what_is_accepted_from_noise_carries_header_and_checksum(noise):
    for frame in codec.StreamParser().feed(noise):
        assert codec.stream_frame(frame.counts) in noise


def test_frames_taken_at_once_tell_how_many_bytes_came_after_them():
    stream = b"".join(STREAM.values())
    assert [frame.later_bytes for frame in codec.StreamParser().feed(stream + b"\x20")] == [33, 17, 1]


@given(counts)
def test_saturation_is_30000_counts_in_any_axis_on_either_side(row):
    assert codec.saturated([row]) == any(abs(count) >= 30_000 for count in row)


def test_letters_and_numbers_of_the_nameplate():
    assert codec.firmware_text((0x4654, 0x5301, 0x0203)) == "FTS-1.2.3"
    assert codec.serial_text((0x4142, 0x4300, 42, 0)) == "ABC-0042"
    assert codec.serial_text((0x4142, 0x4300, 1, 2)) == "ABC-131073"
    assert codec.firmware_text((0x1B5B, 0x0001, 0)) == "?[?-1.0.0"


# --- requests and answers, whatever comes ----------------------------------------------------------------


@given(st.binary(max_size=30).filter(lambda data: b"\x09" not in data), st.integers(1, 17))
def test_an_answer_is_found_behind_foreign_bytes_and_in_any_portions(before, size):
    whole = before + WRENCH_REPLY
    line, _ = registers([whole[i : i + size] for i in range(0, len(whole), size)])
    assert codec.signed(line.read(180, 6)) == WRENCH_COUNTS


@given(st.integers(0, 8 * len(WRENCH_REPLY) - 1))
def test_an_answer_with_a_flipped_bit_is_refused_and_the_next_one_taken(bit):
    spoilt = bytearray(WRENCH_REPLY)
    spoilt[bit // 8] ^= 1 << bit % 8
    line, port = registers([bytes(spoilt)], [WRENCH_REPLY])
    assert codec.signed(line.read(180, 6)) == WRENCH_COUNTS
    assert len(port.written) == 2


@given(st.lists(st.binary(min_size=1, max_size=30), max_size=5))
def test_random_bytes_are_never_an_answer(answers):
    line, _ = registers(answers, tries=1)
    with pytest.raises(DeviceError, match="wrench"):
        line.read(180, 6)


def test_the_answer_to_another_request_is_not_taken_for_this_one():
    line, _ = registers([WRENCH_REPLY], tries=1)
    with pytest.raises(DeviceError, match="are not an answer"):
        line.read(500, 3)


def test_a_wrong_checksum_is_called_that():
    line, _ = registers(*[[WRENCH_REPLY[:-1] + b"\x00"]] * 3)
    with pytest.raises(DeviceError, match=r"wrong checksum \(asked 3 times to read register 180, slave 9"):
        line.read(180, 6)


def test_exception_codes_are_told_in_words_and_not_asked_again():
    refusal = bytes((9, 0x83, 2))
    line, port = registers([refusal + checksum(refusal)])
    with pytest.raises(
        DeviceError, match=r"exception 02, it has no such register[\s\S]*check that this port"
    ):
        line.read(600, 1)
    assert len(port.written) == 1


@given(st.binary(max_size=300), st.integers(1, 40))
def test_the_emulator_answers_no_noise_and_noise_in_portions_is_noise_all_the_same(noise, size):
    at_once = list(slave({180: 1}).hear(noise))
    portions = slave({180: 1})
    assert at_once == [a for i in range(0, len(noise), size) for a in portions.hear(noise[i : i + size])]
    for heard, _ in at_once:
        assert heard in noise
        assert checksum(heard[:-2]) == heard[-2:]


@given(st.integers(0, 63))
def test_the_emulator_answers_no_request_with_a_flipped_bit(bit):
    spoilt = bytearray(READS[180, 6])
    spoilt[bit // 8] ^= 1 << bit % 8
    assert list(slave({180 + i: 0 for i in range(6)}).hear(bytes(spoilt))) == []


def test_the_emulator_is_silent_to_another_address_and_refuses_what_it_has_not():
    other = bytes((8, *READS[180, 6][1:6]))
    assert list(slave({}).hear(other + checksum(other))) == []
    refused = bytes((9, 0x83, 2))
    assert [answer for _, answer in slave({}).hear(READS[180, 6])] == [refused + checksum(refused)]


# --- gaps ------------------------------------------------------------------------------------------------


def _lost(times):
    counter = GapCounter(0.01)
    return sum(counter.hear(float(time)) for time in times) + counter.settle()


@given(st.integers(0, 2**32), st.sets(st.integers(60, 240), max_size=30), st.floats(-0.01, 0.01))
def test_missing_frames_are_counted_whatever_the_jitter_and_a_sensor_clock_1_percent_off(
    seed, missing, drift
):
    rng = np.random.default_rng(seed)
    sent = np.array([n for n in range(300) if n not in missing])
    arrival = 0.01 * (1 + drift) * sent + rng.exponential(0.001, len(sent))
    assert _lost(np.maximum.accumulate(arrival)) == len(missing)


@given(st.integers(1, 250), st.floats(0.02, 0.24))
def test_frames_that_only_come_late_because_the_host_was_busy_are_not_lost(begin, stall_s):
    arrival = 0.01 * np.arange(300)
    stalled = (arrival > 0.01 * begin) & (arrival < 0.01 * begin + stall_s)
    # read at once after the stall, they are stamped one frame's time on the wire apart
    behind = np.arange(stalled.sum())[::-1]
    arrival[stalled] = np.maximum(0.01 * begin + stall_s - behind * 16 * 10 / 19_200, arrival[stalled])
    assert _lost(np.maximum.accumulate(arrival)) == 0
