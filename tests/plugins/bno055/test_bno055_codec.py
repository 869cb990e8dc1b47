"""Bytes of the BNO055 in the driver and, independently, in the emulator: golden vectors, and anything at all."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.bno055 import codec
from labrun_plugins.bno055.emulator import Bno055Emulator, EmulatedChip, Motion, Status
from labrun_plugins.bno055.sampling import (
    CHANNELS,
    Plausibility,
    angles,
    tilt,
    turn_between,
    up_in_body,
    values_of,
)
from labrun_plugins.bno055.settings import Bno055Settings
from labrun_plugins.simulated.bno055 import SimulatedBno055, SimulatedBno055Settings
from scipy.spatial.transform import Rotation

from labrun.devices import DeviceContext
from labrun.devices.emulation import EmulatorContext, EmulatorLog, Faults


def frame(text: str) -> bytes:
    return bytes.fromhex(text)


STILL = Motion((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
GOLDEN = Motion((0.7071, 0.0, 0.7071, 0.0), tuple(np.radians([90.0, -12.5, 45.0])), (0.0, 0.0, 0.0))


class HandClock:
    poll_s = 0.02

    def __init__(self, now_s=100.0):
        self.now_s = now_s

    def now(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += duration_s


class StillScene:
    joints = ()
    signals = dict.fromkeys([f"base_{part}" for part in ("qw", "qx", "qy", "qz", "wx", "wy", "wz")], "1")

    def observe(self, signals, time_s):
        return np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(time_s), 1))


class Wire:
    """The emulator within this process, asked byte by byte over its pty; time moves by hand."""

    def __init__(self, folder, faults=None):
        self.clock = HandClock()
        context = EmulatorContext(
            self.clock,
            np.random.default_rng(3),
            folder,
            StillScene(),
            Faults(faults or {}),
            log=EmulatorLog(None, self.clock),
        )
        self.emulator = Bno055Emulator("imu", SimulatedBno055Settings(port="p", mounted_on="base"), context)
        self.end = os.open(self.emulator.open()["port"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def ask(self, request, within_s=0.1):
        os.write(self.end, request)
        heard = b""
        for _ in range(round(within_s / 0.001)):
            self.emulator.step(self.clock.now())
            self.clock.sleep(0.001)
            try:
                heard += os.read(self.end, 4096)
            except BlockingIOError:
                continue
        return heard

    def close(self):
        os.close(self.end)
        self.emulator.close()


@pytest.fixture
def wire(tmp_path):
    made = Wire(tmp_path)
    yield made
    made.close()


def chip_of(motion):
    chip = EmulatedChip(lambda _: motion)
    for register, value in ((0x3B, 0x00), (0x3D, 0x08)):
        chip.write(register, bytes((value,)), 0.0)
    return chip


# --- golden vectors -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "golden"),
    [
        (codec.read_request(0x00, 1), "AA 01 00 01"),
        (codec.read_request(0x00, 4), "AA 01 00 04"),
        (codec.write_request(codec.MODE, bytes((codec.CONFIG_MODE,))), "AA 00 3D 01 00"),
        (codec.write_request(codec.MODE, bytes((codec.FUSION_MODE["imu"],))), "AA 00 3D 01 08"),
        (codec.write_request(codec.MODE, bytes((codec.FUSION_MODE["ndof"],))), "AA 00 3D 01 0C"),
        (codec.write_request(codec.UNITS, bytes((codec.DEGREES,))), "AA 00 3B 01 00"),
        (codec.write_request(codec.TRIGGER, bytes((codec.RESET,))), "AA 00 3F 01 20"),
        (codec.read_request(codec.QUATERNION, 8), "AA 01 20 08"),
        (codec.read_request(codec.EULER, 6), "AA 01 1A 06"),
        (codec.read_request(codec.EULER, 26), "AA 01 1A 1A"),
    ],
)
def test_the_driver_makes_the_golden_requests(made, golden):
    assert made == frame(golden)


@pytest.mark.parametrize(
    ("request_text", "answer_text"),
    [
        ("AA 01 00 01", "BB 01 A0"),
        ("AA 01 00 04", "BB 04 A0 FB 32 0F"),
        ("AA 00 3D 01 00", "EE 01"),
        ("AA 00 3D 01 08", "EE 01"),
        ("AA 00 3D 01 0C", "EE 01"),
        ("AA 00 3B 01 00", "EE 01"),
    ],
)
def test_the_emulator_gives_the_golden_answers_and_the_driver_reads_them(wire, request_text, answer_text):
    answer = wire.ask(frame(request_text))
    assert answer == frame(answer_text)
    if answer[0] == 0xBB:
        assert codec.answer_to_read(answer, answer[1]) == codec.Answer("data", data=answer[2:])
    else:
        assert codec.answer_to_write(answer) == codec.Answer("status", status=1)


def test_golden_quaternion_and_angles_are_what_the_emulator_has_in_its_registers():
    chip = chip_of(GOLDEN)
    assert chip.read(0x20, 8, 1.0) == frame("41 2D 00 00 41 2D 00 00")
    assert chip.read(0x1A, 6, 1.0) == frame("A0 05 38 FF D0 02")


def test_the_driver_reads_golden_quaternion_and_angles_out_of_a_block():
    turned = codec.answer_to_read(frame("BB 06 A0 05 38 FF D0 02"), 6)
    lies = codec.answer_to_read(frame("BB 08 41 2D 00 00 41 2D 00 00"), 8)
    assert turned.kind == lies.kind == "data"
    data = bytes(6) + turned.data + lies.data + bytes(12)
    block = codec.block(data)
    np.testing.assert_allclose(block.quaternion, [0.7071, 0, 0.7071, 0], atol=2**-15)
    np.testing.assert_allclose(np.degrees(block.euler_rad), [90, -12.5, 45], atol=1e-9)


def test_the_golden_block_has_26_bytes_and_is_the_end_of_the_drivers(wire):
    wire.ask(frame("AA 00 3B 01 00"))
    wire.ask(frame("AA 00 3D 01 08"))
    long = wire.ask(codec.read_request(codec.BLOCK, codec.BLOCK_BYTES))
    golden = wire.ask(frame("AA 01 1A 1A"))
    assert golden[:2] == frame("BB 1A")
    assert len(golden) == 28
    assert len(long) == 34
    np.testing.assert_allclose(np.linalg.norm(codec.block(long[2:]).quaternion), 1.0, atol=1e-3)


def test_an_over_run_is_the_golden_status(tmp_path):
    wire = Wire(tmp_path, {"overrun": 1.0})
    answer = wire.ask(frame("AA 01 00 01"))
    wire.close()
    assert answer == frame("EE 07")
    assert codec.answer_to_read(answer, 1) == codec.Answer("status", status=codec.OVERRUN)


# --- what the chip does ---------------------------------------------------------------------------------------------


def status_of(call):
    with pytest.raises(Status) as caught:
        call()
    return caught.value.code


def test_configuration_can_be_written_in_mode_config_alone():
    chip = chip_of(STILL)
    assert status_of(lambda: chip.write(0x3B, b"\x00", 1.0)) == 3
    assert status_of(lambda: chip.write(0x1A, b"\x00", 1.0)) == 5
    chip.write(0x3D, b"\x00", 1.0)
    assert status_of(lambda: chip.write(0x3B, b"\x00", 1.01)) == 7
    assert chip.write(0x3B, b"\x00", 1.02) == 1
    assert chip.read(0x20, 8, 1.02) == bytes(8)


def test_addresses_and_lengths_out_of_range_have_their_status():
    chip = chip_of(STILL)
    assert status_of(lambda: chip.read(0x6A, 2, 1.0)) == 4
    assert status_of(lambda: chip.read(0x00, 0, 1.0)) == 9
    assert status_of(lambda: chip.read(0x00, 129, 1.0)) == 8
    assert status_of(lambda: chip.write(0x07, b"", 1.0)) == 9


def test_units_follow_the_unit_select_register_whose_value_after_a_reset_is_android():
    chip = EmulatedChip(lambda _: GOLDEN)
    chip.write(0x3D, b"\x08", 0.0)
    assert np.frombuffer(chip.read(0x1A, 6, 1.0), "<i2").tolist() == [1440, -200, -720]
    chip.write(0x3D, b"\x00", 1.0)
    chip.write(0x3B, b"\x06", 2.0)
    chip.write(0x3D, b"\x08", 2.0)
    expected = np.round(900 * np.radians([90, -12.5, 45])).astype(int).tolist()
    assert np.frombuffer(chip.read(0x1A, 6, 3.0), "<i2").tolist() == expected


def test_it_is_silent_for_650_ms_after_a_reset_and_begins_with_the_settings_of_delivery(wire):
    wire.ask(frame("AA 00 3D 01 08"))
    wire.ask(frame("AA 00 3F 01 20"))
    assert wire.ask(frame("AA 01 00 01"), within_s=0.4) == b""
    wire.clock.sleep(0.3)
    assert wire.ask(frame("AA 01 3D 01")) == frame("BB 01 00")


def test_page_1_hides_the_data_until_page_0_is_selected(wire):
    assert wire.ask(frame("AA 00 07 01 01")) == frame("EE 01")
    assert wire.ask(frame("AA 01 00 01")) == frame("BB 01 00")
    wire.ask(frame("AA 00 07 01 00"))
    assert wire.ask(frame("AA 01 00 01")) == frame("BB 01 A0")


def test_a_wrong_start_byte_and_half_a_request_have_their_status(wire):
    assert wire.ask(frame("55 66")) == frame("EE 06")
    assert wire.ask(frame("AA 01 00")) == frame("EE 0A")
    assert wire.ask(frame("AA 01 00 01")) == frame("BB 01 A0")


# --- whatever comes -------------------------------------------------------------------------------------------------


@given(st.binary(max_size=50), st.integers(1, 40))
def test_only_exactly_an_answer_is_taken_for_one(heard, count):
    answer = codec.answer_to_read(heard, count)
    if answer.kind == "data":
        assert heard == bytes((0xBB, count)) + answer.data
        assert len(answer.data) == count
    if answer.kind == "status":
        assert heard == bytes((0xEE, answer.status))
    if codec.answer_to_write(heard).kind == "status":
        assert heard[0] == 0xEE
        assert len(heard) == 2


@given(st.binary(min_size=1, max_size=40), st.data())
def test_an_answer_in_portions_is_awaited_and_then_complete(data, draws):
    whole = bytes((0xBB, len(data))) + data
    seen = draws.draw(st.integers(0, len(whole) - 1))
    assert codec.answer_to_read(whole[:seen], len(data)).kind == "none"
    assert codec.answer_to_read(whole, len(data)).data == data


@given(st.binary(min_size=32, max_size=32), st.integers(0, 34), st.integers(0, 255))
def test_a_byte_too_many_or_too_few_is_damage_or_a_wait_but_never_data_of_another_length(data, at, extra):
    whole = bytes((0xBB, 32)) + data
    longer = whole[:at] + bytes((extra,)) + whole[at:]
    assert codec.answer_to_read(longer, 32).kind == "damaged"
    assert codec.answer_to_read(whole[:-1], 32).kind == "none"
    assert codec.answer_to_read(whole, 31).kind == "damaged"


@given(st.binary(max_size=40))
def test_blocks_and_states_of_another_length_are_refused_and_all_others_are_numbers(data):
    for decode, size in ((codec.block, codec.BLOCK_BYTES), (codec.state, codec.STATE_BYTES)):
        if len(data) == size:
            decode(data)
        else:
            with pytest.raises(ValueError, match=str(size)):
                decode(data)


@settings(max_examples=30)
@given(noise=st.binary(min_size=1, max_size=120))
def test_after_any_noise_the_emulator_answers_again(tmp_path_factory, noise):
    wire = Wire(tmp_path_factory.mktemp("wire"))
    try:
        wire.ask(noise.replace(b"\xaa\x00", b"\x55\x55"), within_s=0.3)
        wire.clock.sleep(1.0)
        wire.ask(b"", within_s=0.05)
        assert wire.ask(frame("AA 01 00 01"), within_s=0.3) == frame("BB 01 A0")
    finally:
        wire.close()


# --- numbers --------------------------------------------------------------------------------------------------------

headings, rolls, pitches = st.floats(0, 359.9), st.floats(-85, 85), st.floats(-175, 175)


def _quaternion(turn):
    x, y, z, w = turn.as_quat()
    return np.array([w, x, y, z])


@given(headings, rolls, pitches)
def test_angles_are_turns_about_z_x_and_y_in_that_order_as_the_stand_in_has_them(heading, roll, pitch):
    turn = Rotation.from_euler("ZXY", [heading, roll, pitch], degrees=True)
    result = np.degrees(angles(_quaternion(turn)))
    np.testing.assert_allclose((result - [heading, roll, pitch] + 180) % 360 - 180, 0, atol=1e-6)
    upright = min(1.0, turn.as_matrix()[2, 2])  # rounding may take it beyond
    assert tilt(_quaternion(turn)) == pytest.approx(np.arccos(upright), abs=1e-6)
    np.testing.assert_allclose(up_in_body(_quaternion(turn)), turn.inv().apply([0, 0, 1]), atol=1e-12)


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_the_turn_between_two_orientations_is_scipys_whatever_the_signs(first, other):
    a, b = Rotation.random(random_state=first), Rotation.random(random_state=other)
    for sign in (1, -1):
        turn = turn_between(sign * _quaternion(a), _quaternion(b))
        assert turn == pytest.approx((a.inv() * b).magnitude(), abs=1e-6)


@settings(max_examples=40)
@given(headings, rolls, pitches, st.tuples(*[st.floats(-1990, 1990)] * 3))
def test_what_the_emulator_sends_reads_as_what_it_felt_to_within_a_step(heading, roll, pitch, rate):
    turn = Rotation.from_euler("ZXY", [heading, roll, pitch], degrees=True)
    euler = np.radians([heading, roll, pitch])
    motion = Motion(_quaternion(turn).tolist(), euler.tolist(), np.radians(rate).tolist())
    block = codec.block(chip_of(motion).read(codec.BLOCK, codec.BLOCK_BYTES, 1.0))
    values = values_of(block)
    np.testing.assert_allclose(values[:4], _quaternion(turn), atol=0.51 * 2**-14)
    np.testing.assert_allclose(np.degrees(values[7:10]), rate, atol=0.51 / 16)
    off = np.degrees(values[4:7] - euler)
    assert np.max(np.abs((off + 180) % 360 - 180)) < 0.02 / np.cos(np.radians(roll))
    np.testing.assert_allclose(np.degrees(block.euler_rad), [heading, roll, pitch], atol=0.51 / 16)
    np.testing.assert_allclose(block.gravity_m_s2, 9.80665 * up_in_body(_quaternion(turn)), atol=0.006)


def test_the_channels_are_those_of_the_stand_in():
    context = DeviceContext(HandClock(), np.random.default_rng(1))
    stand_in = SimulatedBno055("imu", SimulatedBno055Settings(port="p", mounted_on="base"), context)
    assert stand_in.channels == CHANNELS


def test_the_gyroscope_is_saturated_at_2000_degrees_per_second():
    for rate, saturated in ((1999.0, False), (2000.0, True), (-2000.0, True)):
        motion = Motion(STILL.quaternion, STILL.heading_roll_pitch_rad, (0.0, np.radians(rate), 0.0))
        assert codec.block(chip_of(motion).read(codec.BLOCK, 32, 1.0)).saturated == saturated


# --- plausibility ---------------------------------------------------------------------------------------------------


def _block(turn, length=1.0):
    zeros = np.zeros(3)
    return codec.Block(zeros, zeros, length * _quaternion(turn), zeros, saturated=False)


@given(st.integers(0, 7), st.integers(0, 7))
def test_a_flipped_bit_in_the_quaternion_passes_only_where_it_turns_hardly_further_than_the_gyroscope_tells(
    byte, bit
):
    turn = Rotation.from_euler("ZXY", [40, 10, -20], degrees=True)
    chip = chip_of(Motion(_quaternion(turn).tolist(), (0, 0, 0), (0, 0, 0)))
    data = bytearray(chip.read(codec.BLOCK, codec.BLOCK_BYTES, 1.0))
    plausibility = Plausibility(np.radians(300.0))
    assert plausibility.doubt(codec.block(bytes(data)), 0.0) == ""
    data[codec.QUATERNION - codec.BLOCK + byte] ^= 1 << bit
    spoilt = codec.block(bytes(data))
    length = np.linalg.norm(spoilt.quaternion)
    moved = turn_between(_quaternion(turn), spoilt.quaternion / length)
    believed = plausibility.doubt(spoilt, 0.01) == ""
    assert believed == (abs(length - 1) <= 0.01 and moved <= np.radians(6.0))


@pytest.mark.parametrize("length", [0.0, 0.5, 0.985, 1.015, 2.0])
def test_a_quaternion_that_is_none_is_refused(length):
    plausibility = Plausibility(np.radians(300.0))
    assert "instead of 1" in plausibility.doubt(_block(Rotation.identity(), length), 0.0)
    assert plausibility.doubt(_block(Rotation.identity(), 1.005), 0.01) == ""
    assert plausibility.refused == 1


def test_one_reading_far_off_is_refused_and_a_heading_set_anew_is_believed_at_the_second():
    plausibility = Plausibility(np.radians(300.0))
    here, there = Rotation.identity(), Rotation.from_euler("z", 90, degrees=True)
    doubts = [
        plausibility.doubt(_block(turn), 0.01 * number)
        for number, turn in enumerate([here, here, there, here, here, there, there, there])
    ]
    assert [bool(doubt) for doubt in doubts] == [False, False, True, False, False, True, False, False]
    assert plausibility.corrections == 1
    assert plausibility.refused == 2


def test_a_fast_turn_is_believed_if_the_gyroscope_tells_of_it_and_else_not():
    for rate_deg_s, believed in ((0.0, False), (100.0, False), (1500.0, True)):
        plausibility = Plausibility(np.radians(300.0))
        plausibility.doubt(_block(Rotation.identity()), 0.0)
        turned = _block(Rotation.from_euler("x", 15, degrees=True))
        turned = turned._replace(gyro_rad_s=np.radians([rate_deg_s, 0.0, 0.0]))
        assert (plausibility.doubt(turned, 0.01) == "") == believed


# --- settings -------------------------------------------------------------------------------------------------------


def test_offsets_are_22_bytes_in_hexadecimal():
    good = Bno055Settings(port="p", mounted_on="base", offsets="00 01 " * 11)
    assert good.offset_bytes == bytes((0, 1)) * 11
    for wrong, message in (("zz", "hexadecimal"), ("00 01", "22 bytes; these are 2")):
        with pytest.raises(ValueError, match=message):
            Bno055Settings(port="p", mounted_on="base", offsets=wrong)
