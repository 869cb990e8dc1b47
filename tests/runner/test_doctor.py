"""What the doctor says of serial ports."""

from types import SimpleNamespace

import pytest

from labrun.runner import doctor


@pytest.fixture
def adapter(tmp_path, monkeypatch):
    """An FTDI adapter: its device node, and the kernel's folder of its latency timer."""
    node = tmp_path / "ttyUSB0"
    node.touch()
    timer = tmp_path / "usb-serial" / "ttyUSB0" / "latency_timer"
    timer.parent.mkdir(parents=True)
    port = SimpleNamespace(device=str(node), description="USB-RS485")
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    return timer


def _of(findings, subject):
    return next(finding for finding in findings if finding.subject.endswith(subject))


def test_a_slow_latency_timer_is_a_warning_with_the_command_that_mends_it(adapter, tmp_path):
    adapter.write_text("16\n")
    result = _of(doctor.examine_machine(tmp_path, tmp_path / "usb-serial"), "ttyUSB0")
    assert result.verdict == "warning"
    assert "16 ms" in result.message
    assert str(adapter) in result.advice


def test_a_quick_latency_timer_is_fine(adapter, tmp_path):
    adapter.write_text("1\n")
    assert _of(doctor.examine_machine(tmp_path, tmp_path / "usb-serial"), "ttyUSB0").verdict == "ok"


def test_a_port_without_permission_is_a_problem(adapter, tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    result = _of(doctor.examine_machine(tmp_path, tmp_path / "usb-serial"), "ttyUSB0")
    assert result.verdict == "problem"
    assert "dialout" in result.advice


def test_a_disk_that_cannot_be_written_is_a_problem(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(doctor.os, "fsync", full)
    assert _of(doctor.examine_machine(tmp_path), "disk").verdict == "problem"
