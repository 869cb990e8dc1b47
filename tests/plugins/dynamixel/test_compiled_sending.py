"""Set-points as a compiled loop sends them, read by servos that share no code with them."""

import os

import numpy as np
import pytest
from labrun_plugins.dynamixel.codec import instruction
from labrun_plugins.dynamixel.compiled_sending import SENDING, asked, wire_of
from labrun_plugins.dynamixel.control_table import CENTRE, COUNT_RAD, Scale
from labrun_plugins.dynamixel.emulated_packets import SYNC_READ, SYNC_WRITE, InstructionReader
from labrun_plugins.dynamixel.settings import DynamixelSettings

from labrun.devices.compiled import BEYOND, GONE, HALT, HALTED, SENT, TOO_LATE

QUESTION = instruction(0xFE, SYNC_READ, bytes([120, 0, 16, 0, 1, 7]))


class Line:
    """A line into which a loop of 1000 steps a second sends, from time 0 on."""

    def __init__(self, start_rad=(0.0, 0.0), **keys):
        settings = DynamixelSettings.model_validate(
            {
                "port": "/dev/none",
                "joints": {"a": {"id": 1}, "b": {"id": 7, "sign": -1}},
                "feedback_hz": 500,
                **keys,
            }
        )
        scales = [(one.id, Scale.of(one, settings)) for one in settings.joints.values()]
        self.far, self.near = os.pipe()
        os.set_blocking(self.far, False)
        os.set_blocking(self.near, False)
        self.wire = wire_of(self.near, settings, scales, np.array(start_rad), 1000.0, QUESTION, 0.0)

    def send(self, time_s, *angles_rad):
        said, nothing = np.zeros(1), np.zeros(1)
        form = SENDING.python
        form(time_s, self.wire.state, np.array(angles_rad), self.wire.parameters, nothing, said)
        return said[0]

    def read(self):
        try:
            return InstructionReader().feed(os.read(self.far, 4096))
        except BlockingIOError:
            return []


def goals(packet):
    assert packet.sound
    assert packet.code == SYNC_WRITE
    assert packet.parameters[:4] == bytes([116, 0, 4, 0])
    rows = [packet.parameters[n : n + 5] for n in range(4, len(packet.parameters), 5)]
    return {row[0]: int.from_bytes(row[1:], "little", signed=True) for row in rows}


def test_servos_read_the_counts_of_the_angles_that_were_sent():
    line = Line()
    assert line.send(0.001, 0.01, 0.02) == SENT
    (packet,) = line.read()
    assert goals(packet) == {1: CENTRE + round(0.01 / COUNT_RAD), 7: CENTRE - round(0.02 / COUNT_RAD)}


def test_bytes_that_look_like_a_header_are_stuffed():
    count = int.from_bytes(bytes([0xFF, 0xFF, 0xFD, 0xFF]), "little", signed=True)
    angle = (count - CENTRE) * COUNT_RAD
    line = Line((angle, 0.0), operating_mode="extended-position")
    assert line.send(0.001, angle, 0.0) == SENT
    (packet,) = line.read()
    assert goals(packet)[1] == count


def test_where_the_servos_are_is_asked_with_every_second_set_point():
    line = Line()
    for number in range(4):
        assert line.send(0.001 * (number + 1), 0.0, 0.0) == SENT
    codes = [packet.code for packet in line.read()]
    assert codes == 2 * [SYNC_WRITE, SYNC_WRITE, SYNC_READ]
    assert asked(line.wire) == 2


@pytest.mark.parametrize(
    ("keys", "time_s", "angle_rad", "said"),
    [
        ({"limits": {"angle_deg": [-10, 10]}}, 0.001, 0.2, BEYOND),
        ({"limits": {"speed_deg_s": 100}}, 0.001, 0.1, BEYOND),
        ({}, 0.001, np.nan, BEYOND),
        ({"watchdog_ms": 40}, 0.05, 0.0, TOO_LATE),
    ],
)
def test_a_set_point_that_must_not_leave_does_not(keys, time_s, angle_rad, said):
    line = Line(**keys)
    assert line.send(time_s, angle_rad, 0.0) == said
    assert line.read() == []


def test_nothing_is_sent_after_a_stop():
    line = Line()
    line.wire.state[HALT] = 1.0
    assert line.send(0.001, 0.0, 0.0) == HALTED
    assert line.read() == []


def test_a_port_that_is_gone_is_told():
    line = Line()
    os.close(line.far)
    assert line.send(0.001, 0.0, 0.0) == GONE
