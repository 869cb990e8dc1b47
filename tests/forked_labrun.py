"""`labrun` without the second that Python takes to import it: every command is forked from one process that has.

Each worker of the tests starts that process once. What is typed is a program `labrun`, or `forked-python FILE` or
`forked-python -m MODULE`, that hands its arguments, folder, environment and streams to it, and ends as the forked
command did. Emulators and their scenes are begun likewise. Tests of signals, of processes that are killed, and of what
is imported when start them as a person does.
"""

import atexit
import functools
import gc
import importlib
import json
import os
import pkgutil
import runpy
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from select import select

import numpy as np

import labrun.cli
from labrun import registry
from labrun.models import load_model, simulate
from labrun.runner import resolve

_TYPED = """#!{python} -IS
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({address!r})
    asked = json.dumps([sys.argv, os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(server, [len(asked).to_bytes(8, "big")], [0, 1, 2])
    server.sendall(asked)
    code = server.recv(1)
sys.exit(code[0] if code else "labrun was killed")
"""


@functools.cache
def forked_programs() -> Path:
    """Return the folder of the programs `labrun` and `forked-python`; they work until this process ends."""
    folder = tempfile.TemporaryDirectory(prefix="labrun-")
    address = str(Path(folder.name) / "socket")
    server = subprocess.Popen(
        [sys.executable, "-P", __file__, address], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    for name in ("labrun", "forked-python"):
        program = Path(folder.name) / name
        program.write_text(_TYPED.format(python=sys.executable, address=address), encoding="utf-8")
        program.chmod(0o755)
    assert server.stdout is not None
    assert server.stdout.readline() == b"ready\n"

    def end() -> None:
        server.communicate()  # its standard input ends, and so does it
        folder.cleanup()

    atexit.register(end)
    return Path(folder.name)


def run_labrun(
    *arguments: str | Path, cwd: Path, env: dict[str, str] | None = None, timeout: float = 300
) -> subprocess.CompletedProcess[str]:
    """Run one command to its end, and return how it ended and what it printed."""
    return subprocess.run(
        [str(forked_programs() / "labrun"), *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@contextmanager
def forked_emulators() -> Iterator[None]:
    """Fork what an `EmulatedBench` starts meanwhile."""
    usual, resolve._PYTHON = resolve._PYTHON, str(forked_programs() / "forked-python")
    try:
        yield
    finally:
        resolve._PYTHON = usual


def _serve(address: str) -> None:
    sys.path.append(str(Path(__file__).parent))
    import rendering
    import unsynced

    sys.path.pop()
    rendering.leave_pictures_empty()
    unsynced.leave_files_unsynced()
    for package in ("app", "cli", "fit", "gap", "report"):
        for module in pkgutil.walk_packages([str(Path(labrun.__path__[0]) / package)], f"labrun.{package}."):
            importlib.import_module(module.name)
    for name in ("labrun.devices.processes.scene", "labrun.devices.processes.emulator"):
        importlib.import_module(name)
    for group in registry.GROUPS:
        for plugin in registry.installed(group):
            if plugin.target.startswith("labrun"):
                registry.load(group, plugin.name)
    # which loads the integrator and what numba needs for its first function
    simulate(
        load_model("hinge-pendulum"), np.linspace(0.0, 0.1, 11), np.empty((11, 0)), initial_state=[0.1, 0.0]
    )
    gc.collect()
    gc.freeze()  # else every process that is forked goes through all of it, and copies it by that
    resolve._PYTHON = str(Path(address).with_name("forked-python"))
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen()
        print("ready", flush=True)
        while True:
            waiting, _, _ = select([listener, sys.stdin], [], [])
            if sys.stdin in waiting:
                return
            connection, _ = listener.accept()
            if os.fork() == 0:
                listener.close()
                _carry_out(connection)
            connection.close()
            _forget_the_dead()


def _forget_the_dead() -> None:
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return


def _carry_out(connection: socket.socket) -> None:
    """Be the command: with its streams, folder, environment and arguments, as a process of Python would begin."""
    length, streams, _, _ = socket.recv_fds(connection, 8, 3)
    with connection.makefile("rb") as sent:
        (program, *arguments), folder, environment = json.loads(sent.read(int.from_bytes(length, "big")))
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    added = [
        part for part in environment.get("PYTHONPATH", "").split(os.pathsep) if part not in ("", *sys.path)
    ]
    sys.path[:0] = added
    if any(any(Path(part).glob("*.dist-info")) for part in added):
        registry.read_again()
    if Path(program).name == "forked-python":
        code = _code_of(lambda: _python(arguments))
    else:
        sys.argv = ["labrun", *arguments]
        code = _code_of(labrun.cli.main)
    atexit._run_exitfuncs()
    connection.send(bytes([code & 0xFF]))
    os._exit(0)


def _python(arguments: list[str]) -> None:
    if arguments[0] == "-m":
        sys.exit(importlib.import_module(arguments[1]).main())
    sys.argv = arguments
    runpy.run_path(arguments[0], run_name="__main__")


def _code_of(main: Callable[[], object]) -> int:
    try:
        main()
    except SystemExit as end:
        if isinstance(end.code, int):
            return end.code
        if end.code is not None:
            print(end.code, file=sys.stderr)
        return end.code is not None
    except BaseException:  # as the interpreter would
        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return 0


if __name__ == "__main__":
    _serve(sys.argv[1])
