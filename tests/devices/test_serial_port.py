import numpy as np
import pytest

from labrun.devices import DeviceError, SerialPort
from labrun.devices.emulated_ports import PtyEndpoint
from labrun.devices.emulation import EmulatorContext, EmulatorLog
from labrun.runner import RealClock

CLOCK = RealClock()


@pytest.fixture
def far_end(tmp_path):
    log = EmulatorLog(None, CLOCK)
    context = EmulatorContext(CLOCK, np.random.default_rng(1), tmp_path, None, log=log)
    end = PtyEndpoint(context, "tty")
    end.faults = context.faults
    end.log = log
    end.open()
    yield end
    end.close()


@pytest.fixture
def port(far_end):
    port = SerialPort("wrench", str(far_end.path), 19_200, timeout_s=0.2)
    port.open()
    yield port
    port.close()


def heard(far_end, count, within_s=2.0):
    deadline_s, data = CLOCK.now() + within_s, b""
    while len(data) < count and CLOCK.now() < deadline_s:
        data += far_end.receive()
        CLOCK.sleep(0.002)
    return data


def test_bytes_pass_both_ways_as_they_are_without_echo_or_line_ends(port, far_end):
    every_byte = bytes(range(256))
    port.write(every_byte)
    assert heard(far_end, 256) == every_byte
    far_end.send(every_byte)
    far_end.flush(CLOCK.now() + 1)
    data = b""
    while len(data) < 256 and (more := port.read()):
        data += more
    assert data == every_byte


def test_reading_from_a_silent_device_gives_nothing_after_the_time_out(port):
    assert port.read() == b""


def test_what_a_program_before_left_in_the_input_is_gone_after_opening(far_end):
    first = SerialPort("wrench", str(far_end.path), 19_200)
    first.open()
    far_end.send(b"old")
    far_end.flush(CLOCK.now() + 1)
    first.close()
    second = SerialPort("wrench", str(far_end.path), 19_200, timeout_s=0.1)
    second.open()
    assert second.read() == b""
    far_end.send(b"new")
    far_end.flush(CLOCK.now() + 1)
    assert second.read() == b"new"
    second.close()


def test_a_port_that_is_not_there_is_named_with_the_next_thing_to_try(tmp_path):
    port = SerialPort("wrench", str(tmp_path / "ttyUSB9"), 19_200)
    with pytest.raises(DeviceError, match=r"device wrench: cannot find the port .*ttyUSB9\n  plug it in"):
        port.open()


def test_a_file_that_is_no_serial_port_is_told_as_such(tmp_path):
    (tmp_path / "notes.txt").write_text("not a port")
    port = SerialPort("wrench", str(tmp_path / "notes.txt"), 19_200)
    with pytest.raises(DeviceError, match=r"device wrench: .*notes\.txt cannot be opened: "):
        port.open()
    assert not port.is_open


def test_a_baud_rate_that_cannot_be_is_told_as_such(far_end):
    port = SerialPort("wrench", str(far_end.path), 2**40)
    with pytest.raises(DeviceError, match=r"device wrench: .* cannot be opened: "):
        port.open()
    assert not port.is_open


def test_a_port_that_another_program_holds_is_told_as_such(port, far_end):
    second = SerialPort("arm", str(far_end.path), 19_200)
    with pytest.raises(DeviceError, match=r"device arm: another program holds .*\n  fuser"):
        second.open()


def test_pulling_the_plug_is_told_in_reading_and_in_writing(port, far_end):
    far_end.faults.set("unplug", True)
    far_end.receive()
    with pytest.raises(DeviceError, match="was unplugged"):
        for _ in range(3):
            port.read()
    with pytest.raises(DeviceError, match="was unplugged"):
        port.write(b"x")


def test_a_plug_put_back_is_found_under_the_same_path(port, far_end):
    far_end.faults.set("unplug", True)
    far_end.receive()
    assert not far_end.path.exists()
    far_end.faults.set("unplug", None)
    far_end.receive()
    port.open()
    port.write(b"again")
    assert heard(far_end, 5) == b"again"
    assert [line["event"] for line in far_end.log.lines] == ["plugged", "unplugged", "plugged"]


def test_a_port_that_is_not_open_says_so(tmp_path):
    port = SerialPort("wrench", str(tmp_path / "tty"), 19_200)
    with pytest.raises(DeviceError, match="is not open"):
        port.read()
    port.close()
