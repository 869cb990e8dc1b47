import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from labrun_plugins.ur5 import rtde as wire
from labrun_plugins.ur5.emulated_arm import MoveL, Program, ScriptReader, SetWatchdog, StopL, StopProgram
from labrun_plugins.ur5.emulator import Session, framed, pack_values, text_message, unpack_values
from labrun_plugins.ur5.motion import STOP, STOP_PROGRAM, move_program
from labrun_plugins.ur5.programs import PrimaryStream
from labrun_plugins.ur5.rtde import Package, PackageStream, Recipe, Text

from labrun.devices.emulation import EmulatorLog, Faults
from labrun.runner import RealClock

POSE = (0.1, -0.4, 0.3, 0.0, 3.14, 0.0)
OUTPUTS = bytes.fromhex("00 24 4F 40 7F 40 00 00 00 00 00") + b"timestamp,actual_TCP_pose"
OUTPUTS_REPLY = bytes.fromhex("00 13 4F 01") + b"DOUBLE,VECTOR6D"
OUTPUTS_UNKNOWN = bytes.fromhex("00 14 4F 00") + b"DOUBLE,NOT_FOUND"
INPUT_NAMES = ("input_int_register_24", "speed_slider_mask", "speed_slider_fraction")
INPUTS = bytes.fromhex("00 40 49") + ",".join(INPUT_NAMES).encode()
INPUTS_REPLY = bytes.fromhex("00 17 49 01") + b"INT32,UINT32,DOUBLE"
INPUTS_IN_USE = bytes.fromhex("00 17 49 00") + b"INT32,UINT32,IN_USE"
VERSION = bytes.fromhex("00 13 76 00 00 00 05 00 00 00 0B 00 00 00 01 00 01 A7 1E")
DATA = bytes.fromhex(
    "00 3C 55 01 40 29 00 00 00 00 00 00 3F B9 99 99 99 99 99 9A BF D9 99 99 99 99 99 9A 3F D3 33 33 33 33 33 33"
    " 00 00 00 00 00 00 00 00 40 09 1E B8 51 EB 85 1F 00 00 00 00 00 00 00 00"
)
INPUT_DATA = bytes.fromhex("00 14 55 01 00 00 00 07 00 00 00 01 3F E0 00 00 00 00 00 00")
SAFETY_DATA = bytes.fromhex("00 08 55 01 00 00 04 04")
TEXT = bytes.fromhex("00 0F 4D 05 68 65 6C 6C 6F 04 52 54 44 45 02")


def payload(package: bytes) -> bytes:
    (only,) = PackageStream().feed(package)
    return only.payload


def session(faults=None, version=(5, 11, 1, 108318), owned=None):
    known = {
        "timestamp": ("DOUBLE", 12.5),
        "actual_TCP_pose": ("VECTOR6D", POSE),
        "safety_status_bits": ("UINT32", 0x404),
    }
    written = []
    log = EmulatorLog(None, RealClock())
    shared = {} if owned is None else owned
    made = Session(
        Faults(faults), log, version, lambda: known, shared, lambda name, value: written.append((name, value))
    )
    return made, known, written


def test_the_driver_writes_the_golden_requests():
    assert wire.protocol_request(2) == bytes.fromhex("00 05 56 00 02")
    assert wire.encode(wire.CONTROLLER_VERSION) == bytes.fromhex("00 03 76")
    assert wire.outputs_request(("timestamp", "actual_TCP_pose"), 500.0) == OUTPUTS
    assert wire.inputs_request(INPUT_NAMES) == INPUTS
    assert wire.encode(wire.START) == bytes.fromhex("00 03 53")
    assert wire.encode(wire.PAUSE) == bytes.fromhex("00 03 50")
    recipe = Recipe(1, INPUT_NAMES, ("INT32", "UINT32", "DOUBLE"))
    assert (
        wire.encode(wire.DATA, recipe.encode(dict(zip(INPUT_NAMES, (7, 1, 0.5), strict=True)))) == INPUT_DATA
    )


def test_the_driver_reads_the_golden_replies():
    assert wire.accepted(payload(bytes.fromhex("00 04 56 01")))
    assert not wire.accepted(payload(bytes.fromhex("00 04 56 00")))
    assert wire.controller_version(payload(VERSION)) == (5, 11, 1, 108318)
    assert wire.types_of(payload(OUTPUTS_REPLY), with_recipe=True) == (1, ("DOUBLE", "VECTOR6D"))
    assert wire.types_of(payload(OUTPUTS_UNKNOWN), with_recipe=True) == (0, ("DOUBLE", "NOT_FOUND"))
    assert wire.types_of(payload(INPUTS_REPLY), with_recipe=True) == (1, ("INT32", "UINT32", "DOUBLE"))
    assert wire.types_of(payload(INPUTS_IN_USE), with_recipe=True) == (0, ("INT32", "UINT32", "IN_USE"))
    assert wire.accepted(payload(bytes.fromhex("00 04 53 01")))
    assert wire.accepted(payload(bytes.fromhex("00 04 50 01")))
    recipe = Recipe(1, ("timestamp", "actual_TCP_pose"), ("DOUBLE", "VECTOR6D"))
    assert recipe.decode(payload(DATA)) == {"timestamp": 12.5, "actual_TCP_pose": POSE}
    safety = Recipe(1, ("safety_status_bits",), ("UINT32",))
    assert safety.decode(payload(SAFETY_DATA)) == {"safety_status_bits": 0x404}
    assert wire.text_of(payload(TEXT)) == Text("hello", "RTDE", 2)


def test_the_emulator_answers_the_golden_requests_with_the_golden_replies():
    arm, known, written = session()
    for request, answer in [
        (bytes.fromhex("00 05 56 00 02"), bytes.fromhex("00 04 56 01")),
        (bytes.fromhex("00 03 76"), VERSION),
        (OUTPUTS, OUTPUTS_REPLY),
        (INPUTS, INPUTS_REPLY),
        (bytes.fromhex("00 03 53"), bytes.fromhex("00 04 53 01")),
        (bytes.fromhex("00 03 50"), bytes.fromhex("00 04 50 01")),
    ]:
        assert arm.feed(request) == [answer]
    assert arm.rate_hz == 500.0
    assert arm.data(known) == DATA
    assert arm.feed(INPUT_DATA) == []
    assert written == list(zip(INPUT_NAMES, (7, 1, 0.5), strict=True))
    assert text_message("hello", "RTDE", 2) == TEXT


def test_the_emulator_refuses_in_the_golden_words():
    arm, _, _ = session({"no-v2": True})
    assert arm.feed(bytes.fromhex("00 05 56 00 02")) == [bytes.fromhex("00 04 56 00")]
    arm, known, _ = session({"not-found": "actual_TCP_pose"})
    arm.feed(bytes.fromhex("00 05 56 00 02"))
    assert arm.feed(OUTPUTS) == [OUTPUTS_UNKNOWN]
    owned = {}
    first, _, _ = session(owned=owned)
    second, known, _ = session(owned=owned)
    first.feed(framed("I", b"speed_slider_fraction"))
    assert second.feed(INPUTS) == [INPUTS_IN_USE]
    first.leave()
    assert second.feed(INPUTS) == [INPUTS_REPLY]
    bits = framed(
        "O", struct.pack("!d", 125.0) + b"safety_status_bits,"
    )  # a trailing comma, as one client sends
    second.feed(bytes.fromhex("00 05 56 00 02") + bits)
    assert second.data(known) == SAFETY_DATA


def test_protocol_1_has_neither_rate_nor_recipe_number():
    arm, known, _ = session()
    assert arm.feed(wire.protocol_request(1)) == [bytes.fromhex("00 04 56 01")]
    (reply,) = arm.feed(wire.outputs_request(("timestamp", "actual_TCP_pose"), None))
    number, types = wire.types_of(payload(reply), with_recipe=False)
    assert (number, types) == (0, ("DOUBLE", "VECTOR6D"))
    recipe = Recipe(None, ("timestamp", "actual_TCP_pose"), types)
    assert recipe.decode(payload(arm.data(known))) == {"timestamp": 12.5, "actual_TCP_pose": POSE}


def test_a_recipe_of_unknown_or_too_few_types_is_refused():
    with pytest.raises(ValueError, match="unknown type 'VECTOR9D'"):
        Recipe(1, ("a",), ("VECTOR9D",))
    with pytest.raises(ValueError, match="1 types for 2 names"):
        Recipe(1, ("a", "b"), ("DOUBLE",))
    with pytest.raises(ValueError, match="2048"):
        wire.inputs_request(("x" * 3000,))


KINDS = st.sampled_from([wire.DATA, wire.TEXT, wire.VERSION_REQUEST, wire.OUTPUTS, wire.START])
PACKAGES = st.lists(st.tuples(KINDS, st.binary(max_size=80)), max_size=12)


@given(PACKAGES, st.lists(st.integers(1, 20), min_size=1, max_size=40))
def test_chunking_does_not_change_what_the_driver_reads(packages, cuts):
    data = b"".join(wire.encode(kind, body) for kind, body in packages)
    stream, result, index = PackageStream(), [], 0
    for cut in cuts * (len(data) + 1):
        if index >= len(data):
            break
        result += stream.feed(data[index : index + cut])
        index += cut
    assert result == [Package(*package) for package in packages]
    assert not stream.broken


@given(st.lists(st.binary(max_size=300), max_size=20))
@example([b"\x00\x01U"])
@example([b"\xff\xffU" + bytes(5000)])
def test_garbage_never_makes_the_driver_crash_or_grow(chunks):
    stream, primary = PackageStream(), PrimaryStream()
    recipe = Recipe(1, ("timestamp", "actual_TCP_pose"), ("DOUBLE", "VECTOR6D"))
    for chunk in chunks:
        for package in stream.feed(chunk):
            wire.text_of(package.payload)
            wire.controller_version(package.payload)
            wire.types_of(package.payload, with_recipe=True)
            values = recipe.decode(package.payload)
            assert values is None or len(package.payload) == recipe.size
        for line in primary.feed(chunk):
            assert line.isprintable()
    assert len(stream._rest) <= 4096
    if stream.broken:
        assert stream.feed(wire.encode(wire.START)) == []


@given(st.binary(min_size=0, max_size=120))
def test_data_of_another_length_or_recipe_is_no_data(body):
    recipe = Recipe(3, ("timestamp",), ("DOUBLE",))
    values = recipe.decode(body)
    assert (values is not None) == (len(body) == 9 and body[0] == 3)


TYPES = st.lists(
    st.sampled_from(
        ["BOOL", "UINT8", "UINT32", "UINT64", "INT32", "DOUBLE", "VECTOR3D", "VECTOR6D", "VECTOR6INT32"]
    ),
    min_size=1,
    max_size=8,
)


@given(TYPES, st.data())
def test_driver_and_emulator_agree_on_every_type(types, data):
    finite = st.floats(allow_nan=False)
    small = st.integers(0, 255)
    values = []
    for kind in types:
        numbers = finite if kind in ("DOUBLE", "VECTOR3D", "VECTOR6D") else small
        size = {"VECTOR3D": 3, "VECTOR6D": 6, "VECTOR6INT32": 6}.get(kind, 1)
        drawn = data.draw(st.lists(numbers, min_size=size, max_size=size))
        values.append(drawn[0] if size == 1 else tuple(drawn))
    names = [f"n{number}" for number in range(len(types))]
    recipe = Recipe(7, names, types)
    packed = pack_values(types, values)
    assert recipe.decode(b"\x07" + packed) == dict(zip(names, values, strict=True))
    assert recipe.encode(dict(zip(names, values, strict=True))) == b"\x07" + packed
    assert unpack_values(types, packed) == [list(v) if isinstance(v, tuple) else v for v in values]


@given(st.lists(st.binary(max_size=200), max_size=15))
@example(
    [wire.protocol_request(2), b"\x00\x05O\x00\x00", b"\x00\x0cU\xff" + bytes(8), b"\x00\x03I", b"\x00\x03U"]
)
@example([wire.protocol_request(2), b"\x00\x0bO" + struct.pack("!d", float("nan"))])
def test_garbage_never_crashes_the_emulators_rtde(chunks):
    arm, _, _ = session()
    for chunk in chunks:
        replies = arm.feed(chunk)
        if replies is None:
            break
        for reply in replies:
            assert struct.unpack("!H", reply[:2])[0] == len(reply)


def test_a_move_is_the_program_that_the_emulator_understands():
    text = move_program(
        POSE, speed_m_s=0.05, acceleration_m_s2=0.5, register="input_int_register_24", watchdog_s=0.1
    )
    (program,) = ScriptReader().feed(text.encode())
    assert isinstance(program, Program)
    watchdog, move = program.statements
    assert watchdog == SetWatchdog("input_int_register_24", 10.0, "stop")
    assert move == MoveL(POSE, 0.5, 0.05)
    assert ScriptReader().feed(STOP.encode()) == [Program("line", (StopL(2.0),))]
    assert ScriptReader().feed(STOP_PROGRAM.encode()) == [StopProgram()]


@given(st.tuples(*[st.floats()] * 6), st.floats(), st.floats(min_value=0.02, max_value=5))
def test_only_finite_numbers_ever_reach_a_program(pose, speed, watchdog_s):
    def made():
        return move_program(
            pose,
            speed_m_s=speed,
            acceleration_m_s2=0.5,
            register="input_int_register_24",
            watchdog_s=watchdog_s,
        )

    import math

    if not all(math.isfinite(number) for number in (*pose, speed)):
        with pytest.raises(ValueError, match="in a program"):
            made()
        return
    text = made()
    assert set(text) <= set('abcdefghijklmnopqrstuvwxyz_0123456789 .,-=()[]":\n')
    assert text.count("\n") == 4


def test_a_register_that_is_no_name_is_refused():
    with pytest.raises(ValueError, match="not an input register"):
        move_program(POSE, speed_m_s=0.1, acceleration_m_s2=0.5, register='x")\npowerdown(', watchdog_s=0.1)


SNIPPETS = st.sampled_from(
    [
        "def a():", "sec b():", "end", "movel(p[0,0,0,0,0,0], a=1, v=1)", "movel(p[0,0,0,0,0,0], a=1, v=1e999)",
        "stopl(2)", "stopl(-1)", "stop program", 'rtde_set_watchdog("x", 10, "stop")', "powerdown()", "import os", "",
        '__import__("os").system("true")', "movel(get_actual_tcp_pose(), a=1, v=1)",
    ]
)  # fmt: skip


@given(st.lists(st.one_of(SNIPPETS.map(str.encode), st.binary(max_size=60)), max_size=20), st.integers(1, 30))
def test_garbage_never_crashes_the_emulators_script_reader(lines, cut):
    data = b"\n".join(lines) + b"\n"
    whole = ScriptReader().feed(data)
    reader, pieces = ScriptReader(), []
    for index in range(0, len(data), cut):
        pieces += reader.feed(data[index : index + cut])
    assert pieces == whole
    for heard in whole:
        if isinstance(heard, Program):
            for statement in heard.statements:
                assert isinstance(statement, MoveL | StopL | SetWatchdog)


def test_complaints_are_picked_out_of_the_primary_port():
    def package(kind, body):
        return struct.pack("!IB", 5 + len(body), kind) + body

    def message(kind, body):
        return package(20, struct.pack("!QbB", 1, -2, kind) + body)

    exception = message(10, struct.pack("!ii", 3, 7) + b"syntax error\x00\n")
    fault = message(6, struct.pack("!iiiII", 204, 3, 3, 0, 0) + b"joint limit")
    warning = message(6, struct.pack("!iiiII", 55, 0, 2, 0, 0) + b"fan")
    label = message(1, bytes(8))
    data = package(16, bytes(40)) + exception + warning + label + fault
    results = []
    stream = PrimaryStream()
    for index in range(len(data)):
        results += stream.feed(data[index : index + 1])
    assert results == ["line 3, column 7: syntax error", "C204A3 joint limit"]
    assert PrimaryStream().feed(package(20, b"\x00\x01")) == []
    lost = PrimaryStream()
    assert lost.feed(b"\x00\x00\x00\x01\x10" + exception) == []
    assert lost.broken
