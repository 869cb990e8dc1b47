"""Garbage on the wire: nothing that arrives makes a parser fail, hang or invent a measurement."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.optitrack import emulator_wire as wire
from labrun_plugins.optitrack import messages
from labrun_plugins.optitrack.frame import Frame, decode_frame
from labrun_plugins.optitrack.messages import split
from labrun_plugins.optitrack.model import decode_model
from optitrack_frames import FULL, LAYOUTS

VERSIONS = [(2, 0), (2, 5), (2, 9), (2, 11), *LAYOUTS, (4, 3), (9, 9)]
MODEL = [wire.BodyDescription("arm", 11, [(0, 0, 0), (1, 2, 3)]), wire.BodyDescription("wand", 1)]


def _read_all(datagram: bytes, version: tuple[int, int]) -> None:
    """Give a datagram to every parser of driver and emulator, and look at what they take it for."""
    announcement = wire.understand(datagram)
    if announcement is not None:
        wire.connect_form(announcement[1])
    message = split(datagram)
    if message is None:
        return
    payload = message[1]
    messages.server_info(payload)
    messages.echo_ticks(payload)
    messages.answered_number(payload)
    model = decode_model(payload, version)
    if model is not None:
        assert 21 * len(model) <= len(payload)
    for with_markers in (False, True):
        _looks_sound(decode_frame(payload, version, with_markers=with_markers), payload)


def _looks_sound(frame: Frame | None, payload: bytes) -> None:
    if frame is None:
        return
    assert math.isfinite(frame.timestamp_s)
    assert 38 * len(frame.bodies) + 20 * len(frame.markers) <= len(payload)
    for body in frame.bodies:
        if body.measured:
            assert body.params & 1
            assert all(map(math.isfinite, body.pose))
            assert abs(math.hypot(*body.pose[3:]) - 1.0) < 0.011


@settings(max_examples=300, deadline=None)
@given(datagram=st.binary(max_size=400), version=st.sampled_from(VERSIONS))
def test_random_bytes_do_no_harm(datagram, version):
    _read_all(datagram, version)


@settings(max_examples=100, deadline=None)
@given(number=st.integers(0, 100), payload=st.binary(max_size=400), version=st.sampled_from(VERSIONS))
def test_random_payloads_of_every_message_do_no_harm(number, payload, version):
    _read_all(wire.message(number, payload), version)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), written=st.sampled_from(LAYOUTS), read=st.sampled_from(VERSIONS), whole=st.booleans())
def test_mutated_frames_and_models_do_no_harm(data, written, read, whole):
    datagram = bytearray(data.draw(st.sampled_from([wire.frame(FULL, written), wire.model(MODEL, written)])))
    for _ in range(data.draw(st.integers(0, 4))):
        index = data.draw(st.integers(0, len(datagram) - 1))
        datagram[index] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(datagram))) if not whole else len(datagram)
    _read_all(bytes(datagram[:cut]), read)


@pytest.mark.parametrize("version", LAYOUTS)
@settings(max_examples=60, deadline=None)
@given(identifier=st.integers(0, 3), count=st.integers(-(2**31), 2**31 - 1))
def test_a_frame_with_a_wrong_number_of_bodies_is_refused(version, identifier, count):
    """Counts are all that holds a frame together; where one is wrong, the sizes no longer add up."""
    content = wire.Content(1, bodies=[wire.RigidBody(identifier, (0, 0, 0), (0, 0, 0, 1))] * 2)
    payload = bytearray(split(wire.frame(content, version))[1])
    at = 12 if version < (4, 1) else 20
    assert payload[at : at + 4] == (2).to_bytes(4, "little")
    payload[at : at + 4] = (count % 2**32).to_bytes(4, "little")
    assert (decode_frame(bytes(payload), version) is not None) == (count == 2)
