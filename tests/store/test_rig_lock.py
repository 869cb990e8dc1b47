"""Two runs never share a port."""

import os
import stat
import subprocess
import sys

import pytest

from labrun.errors import RequestError, RigBusyError
from labrun.store import disk as rig_lock
from labrun.store.disk import lock_folder, lock_ports

HOLD = """
import sys
from pathlib import Path
from labrun.store.disk import lock_ports
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


def test_locks_stand_where_every_user_of_the_machine_looks(monkeypatch, tmp_path):
    before = lock_folder()
    assert before.name == "labrun"
    for variable in ("XDG_RUNTIME_DIR", "TMPDIR", "HOME"):
        monkeypatch.setenv(variable, str(tmp_path))
    assert lock_folder() == before
    everyones, private = tmp_path / "everyones", tmp_path / "private"
    everyones.mkdir()
    everyones.chmod(0o1777)
    private.mkdir(mode=0o700)
    monkeypatch.setattr(rig_lock, "_SHARED", (private, everyones))
    assert lock_folder() == everyones / "labrun"


def test_locks_are_open_to_every_user_whatever_the_umask(tmp_path):
    folder = tmp_path / "labrun"
    before = os.umask(0o077)
    try:
        with lock_ports(["/dev/ttyUSB0"], folder):
            (lock,) = folder.iterdir()
            assert stat.S_IMODE(folder.stat().st_mode) == 0o1777
            assert stat.S_IMODE(lock.stat().st_mode) == 0o666
    finally:
        os.umask(before)


def test_a_lock_is_made_once_and_only_opened_afterwards(tmp_path, monkeypatch):
    with lock_ports(["/dev/ttyUSB0"], tmp_path):
        pass
    flags = []
    real = os.open

    def noted(path, flag, *rest):
        if str(path).endswith(".lock"):
            flags.append(flag)
        return real(path, flag, *rest)

    monkeypatch.setattr(os, "open", noted)
    with lock_ports(["/dev/ttyUSB0"], tmp_path):
        pass
    # O_CREAT alone on another user's file in a sticky folder is refused by the kernel (fs.protected_regular).
    assert all(flag & os.O_EXCL or not flag & os.O_CREAT for flag in flags)


def test_a_folder_that_cannot_be_made_is_an_error_that_says_what_to_do(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(RequestError, match="port /dev/ttyUSB0 cannot be locked") as caught,
        lock_ports(["/dev/ttyUSB0"], tmp_path / "file" / "labrun"),
    ):
        pass
    assert "mode 1777" in str(caught.value)
