"""One simulated bench for all emulators, in a process of its own, and its proxies.

Started as ``python -m labrun.devices.processes.scene`` with one line of JSON on its standard input; answers
``ready``. It ends a little after its standard input does.
"""

import contextlib
import json
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.managers import BaseManager
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices import FloatArray, Scene, Trajectory
from labrun.devices.clock import RealClock
from labrun.devices.processes import stand_for_hardware
from labrun.errors import LabrunError
from labrun.interrupts import ignore_signals
from labrun.registry import load

READY = "ready"
LINGER_S = 3.0
"""How long emulators outlive the runner: hardware does, and the watchdog has yet to stop it."""
_A_MOMENT_S = 0.02

_EXPOSED = ("arrange", "mount", "begin", "drive", "tow", "observe", "truth", "facts")


class SharedScene:
    """A scene that several processes look at, one at a time."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._lock = threading.Lock()

    def facts(self) -> tuple[dict[str, str], tuple[str, ...]]:
        """Return signals with their units, and joints."""
        return dict(self._scene.signals), tuple(self._scene.joints)

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """See `Scene.arrange`."""
        with self._lock:
            self._scene.arrange(condition)

    def mount(self, number: int) -> None:
        """See `Scene`; a scene may know nothing of mountings."""
        with self._lock:
            getattr(self._scene, "mount", lambda _: None)(number)

    def begin(self, start_s: float) -> None:
        """See `Scene`; on most scenes nothing happens by itself."""
        with self._lock:
            getattr(self._scene, "begin", lambda _: None)(start_s)

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        """See `Scene.drive`."""
        with self._lock:
            self._scene.drive(joint, trajectory, start_s)

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float, *ramps: float) -> None:
        """See `Scene.tow`."""
        with self._lock:
            self._scene.tow(from_m, to_m, speed_m_s, start_s, *ramps)

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """See `Scene.observe`."""
        with self._lock:
            return self._scene.observe(signals, time_s)

    def truth(self) -> dict[str, Any]:
        """See `Scene.truth`."""
        with self._lock:
            return self._scene.truth()


class _Manager(BaseManager):
    pass


class RemoteScene:
    """The scene of another process.

    Parameters
    ----------
    address, key
        Where it is served, and the secret that opens it.
    """

    def __init__(self, address: str, key: bytes) -> None:
        manager = _client(address, key)
        manager.connect()
        self._shared: Any = manager.scene()  # type: ignore[attr-defined]
        self.signals: Mapping[str, str]
        self.joints: tuple[str, ...]
        self.signals, self.joints = self._shared.facts()

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """See `Scene.arrange`."""
        self._shared.arrange(dict(condition))

    def mount(self, number: int) -> None:
        """See `Scene`."""
        self._shared.mount(number)

    def begin(self, start_s: float) -> None:
        """See `Scene`."""
        self._shared.begin(start_s)

    def drive(self, joint: str, trajectory: Trajectory, start_s: float) -> None:
        """See `Scene.drive`."""
        self._shared.drive(joint, trajectory, start_s)

    def tow(self, from_m: float, to_m: float, speed_m_s: float, start_s: float, *ramps: float) -> None:
        """See `Scene.tow`."""
        self._shared.tow(from_m, to_m, speed_m_s, start_s, *ramps)

    def observe(self, signals: Sequence[str], time_s: FloatArray) -> FloatArray:
        """See `Scene.observe`."""
        return np.asarray(self._shared.observe(tuple(signals), np.asarray(time_s)))

    def snapshot(self) -> dict[str, Any]:
        """Return nothing: a bench that runs in real time cannot be wound back."""
        return {}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back nothing."""

    def truth(self) -> dict[str, Any]:
        """See `Scene.truth`."""
        return dict(self._shared.truth())


def _client(address: str, key: bytes) -> _Manager:
    class Client(_Manager):
        pass

    Client.register("scene", exposed=_EXPOSED)
    return Client(address=address, authkey=key)


def _serve(scene: Scene, address: str, key: bytes) -> None:
    class Server(_Manager):
        pass

    shared = SharedScene(scene)
    Server.register("scene", callable=lambda: shared, exposed=_EXPOSED)
    server = Server(address=address, authkey=key).get_server()
    with contextlib.suppress(BrokenPipeError):  # the runner was killed meanwhile: its input's end is minded
        os.write(sys.stdout.fileno(), READY.encode() + b"\n")
    server.serve_forever()


def _end_with_input(address: Path) -> None:
    """End a little after the runner has, and leave nothing behind: who was killed cannot tidy up."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    RealClock().sleep(2 * LINGER_S)
    address.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        address.parent.rmdir()
    os._exit(0)


def _compile(scene: Scene) -> None:
    """Have compiled what moves it: seconds the first time, in which an emulator that looks at it answers nobody."""
    before, now_s = scene.snapshot(), RealClock().now()
    with contextlib.suppress(LabrunError):  # as it is before a trial arranges it, it may not move at all
        scene.observe(tuple(scene.signals), np.array([now_s, now_s + _A_MOMENT_S]))
    scene.restore(before)


def main() -> None:
    """Serve a scene until the runner has ended."""
    ignore_signals()  # a bench does not go away because of Ctrl-C
    asked = sys.stdin.buffer.readline()
    if not asked:  # the runner ended before it asked for anything
        return
    task = json.loads(asked)
    threading.Thread(target=_end_with_input, args=(Path(task["address"]),), daemon=True).start()
    rng = np.random.default_rng(np.random.SeedSequence(task["seed"]))
    scene: Scene = load("labrun.scenes", task["plugin"])(task["settings"], rng)
    _compile(scene)
    stand_for_hardware()
    _serve(scene, task["address"], bytes.fromhex(task["key"]))


if __name__ == "__main__":
    main()
