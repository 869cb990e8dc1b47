"""Two runs never share a port."""

import os
import subprocess
import sys

import pytest

from labrun.errors import RigBusyError
from labrun.store.rig_lock import lock_folder, lock_ports

HOLD = """
import sys
from pathlib import Path
from labrun.store.rig_lock import lock_ports
with lock_ports(sys.argv[2:], Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_run_on_a_port_is_refused_with_the_holder_named(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path), "/dev/ttyACM0", "192.168.1.1"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(RigBusyError, match=rf"port /dev/ttyACM0 is in use by process {holder.pid} since"),
            lock_ports(["/dev/ttyUSB7", "/dev/ttyACM0"], tmp_path),
        ):
            pass
        with lock_ports(["/dev/ttyUSB7"], tmp_path):
            pass  # the refused one held nothing back
        holder.kill()
        holder.wait()
        with lock_ports(["/dev/ttyACM0", "192.168.1.1"], tmp_path):
            pass


def test_a_link_to_a_port_counts_as_the_port(tmp_path):
    port = tmp_path / "ttyUSB0"
    port.touch()
    link = tmp_path / "usb-ATI-sensor"
    link.symlink_to(port)
    locks = tmp_path / "locks"
    with lock_ports([str(port)], locks), pytest.raises(RigBusyError), lock_ports([str(link)], locks):
        pass


def test_different_ports_do_not_disturb_each_other(tmp_path):
    with lock_ports(["a/b", "a_b"], tmp_path), lock_ports(["a:b", "a b"], tmp_path):
        pass


def test_a_port_named_twice_is_locked_once(tmp_path):
    with lock_ports(["/dev/ttyUSB0", "/dev/ttyUSB0"], tmp_path):
        pass


def test_a_forked_child_does_not_keep_the_lock_of_its_dead_parent(tmp_path):
    with lock_ports(["/dev/ttyUSB0"], tmp_path):
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(writing)
            os.read(reading, 1)  # lives on until the parent lets go
            os._exit(0)
        os.close(reading)
    with lock_ports(["/dev/ttyUSB0"], tmp_path):
        pass
    os.close(writing)
    os.waitpid(child, 0)


def test_locks_stand_in_the_users_runtime_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert tmp_path in lock_folder().parents
    with lock_ports(["/dev/ttyUSB0"]):
        assert len(list(lock_folder().glob("*.lock"))) == 1
