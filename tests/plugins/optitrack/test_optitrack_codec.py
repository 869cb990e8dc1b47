"""NatNet in bytes: the driver's reading and the emulator's writing, each against bytes of neither."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.optitrack import emulator_wire as wire
from labrun_plugins.optitrack import messages
from labrun_plugins.optitrack.frame import RECORDING, decode_frame
from labrun_plugins.optitrack.messages import MessageId, split
from labrun_plugins.optitrack.model import decode_model
from optitrack_frames import BODY, FULL, LAYOUTS, PLAIN
from optitrack_golden import (
    CONNECT,
    ECHO,
    ECHO_REPLY,
    FRAME_3_0,
    FRAME_4_1,
    FRAME_RATE,
    FRAME_RATE_240,
    KEEP_ALIVE,
    REQUEST_MODELDEF,
    RIGID_BODY,
    SERVER_FROM_260,
    SERVER_HEADER,
    octets,
)


def _payload(datagram):
    message = split(datagram)
    assert message is not None
    return message


@pytest.mark.parametrize(
    ("sent", "golden"),
    [
        (messages.connect(), CONNECT),
        (messages.encode(MessageId.REQUEST_MODELDEF), REQUEST_MODELDEF),
        (messages.encode(MessageId.KEEPALIVE), KEEP_ALIVE),
        (messages.request("FrameRate"), FRAME_RATE),
        (messages.echo_request(123456789), ECHO),
        (wire.number_response(240.0), FRAME_RATE_240),
        (wire.echo_response(123456789, 987654321), ECHO_REPLY),
        (wire.frame(PLAIN, (3, 0)), FRAME_3_0),
        (wire.frame(wire.Content(**{**vars(PLAIN), "params": 1}), (4, 1)), FRAME_4_1),
    ],
)
def test_what_is_sent_are_the_golden_bytes(sent, golden):
    assert sent == octets(golden)


def test_the_driver_reads_the_golden_answers():
    number, payload = _payload(octets(FRAME_RATE_240))
    assert (number, messages.answered_number(payload)) == (MessageId.RESPONSE, 240.0)
    number, payload = _payload(octets(ECHO_REPLY))
    assert (number, messages.echo_ticks(payload)) == (MessageId.ECHORESPONSE, (123456789, 987654321))


def test_the_emulator_reads_the_golden_questions():
    assert wire.connect_form(wire.understand(octets(CONNECT))[1]) == ("short", None)
    assert wire.understand(octets(REQUEST_MODELDEF)) == (wire.REQUEST_MODELDEF, b"")
    assert wire.understand(octets(KEEP_ALIVE)) == (wire.KEEPALIVE, b"")
    assert wire.understand(octets(FRAME_RATE)) == (wire.REQUEST, b"FrameRate\0")
    assert wire.understand(octets(ECHO)) == (wire.ECHOREQUEST, struct.pack("<Q", 123456789))


def test_the_golden_server_info_goes_both_ways():
    datagram = wire.server_info((3, 1, 0, 0), (4, 1, 0, 0), 10_000_000, 1511, False, "239.255.42.99")
    assert len(datagram) == 283
    assert datagram[:4] == octets(SERVER_HEADER)
    assert datagram[260:] == octets(SERVER_FROM_260)
    golden = octets(SERVER_HEADER) + b"Motive\0".ljust(256, b"?") + octets(SERVER_FROM_260)
    info = messages.server_info(_payload(golden)[1])
    assert info == messages.ServerInfo(
        "Motive", (3, 1, 0, 0), (4, 1, 0, 0), 10_000_000, 1511, False, "239.255.42.99"
    )


def test_a_server_before_natnet_3_has_no_clock():
    old = wire.server_info((1, 9, 0, 0), (2, 9, 0, 0), 1, 1511, True, "239.255.42.99")
    info = messages.server_info(_payload(old)[1])
    assert info is not None
    assert (info.version, info.clock_hz, info.multicast) == ((2, 9), None, None)


@pytest.mark.parametrize(("golden", "version", "params"), [(FRAME_3_0, (3, 0), 0), (FRAME_4_1, (4, 1), 1)])
def test_the_driver_reads_the_golden_frames(golden, version, params):
    number, payload = _payload(octets(golden))
    frame = decode_frame(payload, version)
    assert number == MessageId.FRAMEOFDATA
    assert frame is not None
    (body,) = frame.bodies
    assert body.id == 1
    assert body.pose == pytest.approx((0.1, 0.2, 0.3, 0, 0, 0, 1))
    assert body.error_m == pytest.approx(0.0005)
    assert body.measured
    assert (frame.number, frame.timestamp_s, frame.params) == (42, 12.5, params)
    assert (frame.exposed, frame.received, frame.sent) == (1000, 1100, 1200)
    assert frame.precision == ((3, 7) if version == (4, 1) else None)
    assert octets(RIGID_BODY) in payload


@pytest.mark.parametrize(("stamped", "size"), [(True, 128), (False, 120)])
def test_a_4_0_frame_is_told_by_the_bytes_that_are_left(stamped, size):
    datagram = wire.frame(wire.Content(**{**vars(PLAIN), "stamped": stamped, "params": 2}), (4, 0))
    assert len(datagram) == size
    frame = decode_frame(_payload(datagram)[1], (4, 0))
    assert frame is not None
    assert (frame.precision, frame.params) == ((3, 7) if stamped else None, 2)


@pytest.mark.parametrize("version", LAYOUTS)
def test_everything_else_in_a_frame_is_passed_over(version):
    frame = decode_frame(_payload(wire.frame(FULL, version))[1], version, with_markers=True)
    assert frame is not None
    assert [(body.id, body.pose, body.measured) for body in frame.bodies] == [
        (3, (1, 2, 3, 0.5, -0.5, 0.5, 0.5), True),
        (9, (0, 0, 0, 0, 0, 0, 1), False),
    ]
    assert [(marker.id, marker.position, marker.measured) for marker in frame.markers] == [
        (3 << 16 | 2, (0.5, 0.25, 0.125), True),
        (77, (0, 0, 0), False),
    ]
    assert (frame.number, frame.exposed, frame.sent) == (-7, 2**63 + 5, 2**64 - 1)
    assert (frame.timestamp_s, frame.params) == (99.25, RECORDING)


def test_from_4_1_on_sections_that_are_not_needed_are_passed_over_by_their_size_alone():
    payload = bytearray(_payload(wire.frame(FULL, (4, 1)))[1])
    size = struct.unpack_from("<i", payload, 8)[0]
    payload[12 : 12 + size] = b"\xff" * size  # marker sets that no one could walk through
    frame = decode_frame(bytes(payload), (4, 1))
    assert frame is not None
    assert [body.id for body in frame.bodies] == [3, 9]


@pytest.mark.parametrize("size", [-1, 10**6, 2**31 - 1])
def test_a_section_that_claims_more_than_arrived_is_refused(size):
    payload = bytearray(_payload(octets(FRAME_4_1))[1])
    struct.pack_into("<i", payload, 8, size)
    assert decode_frame(bytes(payload), (4, 1)) is None


@pytest.mark.parametrize("version", LAYOUTS)
def test_no_frame_that_was_cut_is_taken_for_a_frame(version):
    payload = _payload(wire.frame(FULL, version))[1]
    # Of 4.1 nobody says that there must be an end tag; of 4.0, whether there are precision stamps.
    whole = {len(payload) - (4 if version >= (4, 1) else 8 if version == (4, 0) else 0)}
    for size in range(len(payload)):
        assert (decode_frame(payload[:size], version) is not None) == (size in whole)


SAME = {(3, 0): 3, (3, 1): 3, (4, 0): 4, (4, 1): 5, (4, 2): 5}


@pytest.mark.parametrize(
    ("written", "read"), [(w, r) for w in LAYOUTS for r in LAYOUTS if SAME[w] != SAME[r]]
)
def test_a_frame_of_another_layout_is_not_taken_for_one(written, read):
    frame = decode_frame(_payload(wire.frame(FULL, written))[1], read)
    if (SAME[written], SAME[read]) == (3, 4):
        assert frame is not None  # 4.0 without precision stamps is what 3.0 is
    else:
        assert frame is None


def test_a_pose_is_a_measurement_only_if_tracked_finite_and_of_unit_length():
    def measured(**fields):
        body = wire.RigidBody(**{**vars(BODY), **fields})
        frame = decode_frame(_payload(wire.frame(wire.Content(1, bodies=[body]), (3, 0)))[1], (3, 0))
        return frame is not None and frame.bodies[0].measured

    assert measured()
    assert not measured(params=0)
    assert not measured(position=(math.nan, 0, 0))
    assert not measured(orientation=(0, 0, 0, 0))
    assert not measured(orientation=(0, 0, math.inf, 1))


@pytest.mark.parametrize("latency", [b"", struct.pack("<f", 0.004)])
@pytest.mark.parametrize("version", [(2, 0), (2, 6), (2, 7), (2, 9), (2, 11)])
def test_frames_of_natnet_2_carry_the_markers_of_a_body_before_its_error(version, latency):
    body = struct.pack("<i3f4f", 5, 1, 2, 3, 0, 0, 0, 1)
    body += struct.pack("<i6f2i2f", 2, *range(6), 8, 9, 0.1, 0.1) + struct.pack("<f", 0.25)
    body += struct.pack("<h", 1) if version >= (2, 6) else b""
    payload = struct.pack("<4i", 17, 0, 0, 1) + body
    later = [(2, 1), (2, 3), (2, 9), (2, 11)]  # skeletons, labelled markers, force plates, devices
    payload += struct.pack("<i", 0) * sum(version >= since for since in later)
    time = struct.pack("<d" if version >= (2, 7) else "<f", 2.5)
    payload += latency + struct.pack("<II", 1, 2) + time + struct.pack("<hI", RECORDING, 0)
    frame = decode_frame(payload, version)
    assert frame is not None
    assert (frame.number, frame.timestamp_s, frame.params) == (17, 2.5, RECORDING)
    assert (frame.bodies[0].pose[:3], frame.bodies[0].error_m) == ((1, 2, 3), 0.25)


@pytest.mark.parametrize("rich", [True, False])
@pytest.mark.parametrize("version", LAYOUTS)
def test_the_model_names_the_bodies_whatever_stands_around_them(version, rich):
    bodies = [
        wire.BodyDescription("arm", 11, [(0, 0, 0), (1, 2, 3)]),
        wire.BodyDescription("Körper", 12),
    ]
    model = decode_model(_payload(wire.model(bodies, version, rich=rich))[1], version)
    assert model is not None
    assert [(body.name, body.id, body.markers) for body in model] == [("arm", 11, 2), ("Körper", 12, 0)]


@pytest.mark.parametrize(
    ("payload", "form"),
    [
        (b"Ping\0", ("short", None)),
        (b"Ping", ("short", None)),
        (b"client\0".ljust(264, b"\0"), ("named", None)),
        (_payload(messages.connect_with_version((4, 1)))[1], ("long", (4, 1))),
        (b"Ping".ljust(270, b"\0"), ("long", None)),
    ],
)
def test_the_emulator_takes_all_forms_of_connecting(payload, form):
    assert wire.connect_form(payload) == form


def test_a_nul_that_is_not_counted_does_no_harm():
    assert split(octets(FRAME_3_0) + b"\0") == split(octets(FRAME_3_0))
    assert split(octets(FRAME_3_0)[:-1]) is None


FLOAT = st.floats(width=32, allow_nan=False, allow_infinity=False)
VECTOR = st.tuples(FLOAT, FLOAT, FLOAT)
BODIES = st.lists(
    st.builds(
        wire.RigidBody, st.integers(-(2**31), 2**31 - 1), VECTOR, st.tuples(FLOAT, FLOAT, FLOAT, FLOAT),
        FLOAT, st.integers(-(2**15), 2**15 - 1),
    ),
    max_size=4,
)  # fmt: skip
U64 = st.integers(0, 2**64 - 1)
CONTENTS = st.builds(
    wire.Content,
    st.integers(-(2**31), 2**31 - 1),
    bodies=BODIES,
    marker_sets=st.lists(
        st.tuples(
            st.text(st.characters(exclude_characters="\0", codec="utf-8")), st.lists(VECTOR, max_size=3)
        ),
        max_size=3,
    ),
    others=st.lists(VECTOR, max_size=3),
    skeletons=st.lists(st.tuples(st.integers(0, 99), BODIES), max_size=2),
    markers=st.lists(st.builds(wire.LabelledMarker, st.integers(0, 2**31 - 1), VECTOR), max_size=4),
    plates=st.lists(
        st.builds(wire.Analog, st.integers(0, 9), st.lists(st.lists(FLOAT, max_size=3), max_size=3)),
        max_size=2,
    ),
    timestamp=st.floats(allow_nan=False, allow_infinity=False),
    ticks=st.tuples(U64, U64, U64),
    params=st.integers(-(2**15), 2**15 - 1),
)


@settings(max_examples=60, deadline=None)
@given(content=CONTENTS, version=st.sampled_from(LAYOUTS))
def test_whatever_the_emulator_sends_the_driver_reads(content, version):
    frame = decode_frame(_payload(wire.frame(content, version))[1], version, with_markers=True)
    assert frame is not None
    assert (frame.number, frame.timestamp_s, frame.params) == (
        content.number,
        content.timestamp,
        content.params,
    )
    assert (frame.exposed, frame.received, frame.sent) == content.ticks
    assert [(b.id, b.pose, b.params) for b in frame.bodies] == [
        (b.id, (*b.position, *b.orientation), b.params) for b in content.bodies
    ]
    assert [(m.id, m.position) for m in frame.markers] == [(m.id, m.position) for m in content.markers]
