"""The bench as one thing: its devices, and the scene that stands in for it in a dry run."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from labrun.devices import (
    Actuator,
    Arranging,
    Carriage,
    Clock,
    Device,
    DeviceContext,
    Identity,
    Limits,
    Paced,
    Scene,
    Sensor,
)
from labrun.errors import DeviceError, LabrunError, RequestError, SpecError
from labrun.experiment import Experiment, scene_of
from labrun.registry import load
from labrun.runner.resolve import STAND_IN, EmulatedBench, ResolvedDevice, missing_ports, resolve_device
from labrun.runner.safety import (
    PATIENCE_S,
    DeviceCalls,
    Watchdog,
    at_once,
    start_watchdog,
    stop_all,
    wrong_answer,
)

_SCENE_STREAM = 0x5CE
_DEVICE_STREAM = 0xDEF
_CLOSING_S = 10.0
"""How long devices may take to disconnect."""


class Rig:
    """The devices of one experiment.

    Attributes
    ----------
    devices
        All of them by name, in the file's order; `actuators`, `arranging`, `paced`, `sensors` and `carriages` are
        those with that capability.
    joints
        Which actuator moves a joint: joint -> device name.
    scene
        The simulated bench, of a dry run or behind emulators; None on hardware.
    dry_run
        Whether time is simulated and every device a stand-in.
    emulated
        Whether emulators stand behind the drivers.
    """

    def __init__(
        self,
        resolved: Sequence[ResolvedDevice],
        *,
        clock: Clock,
        seed: int,
        scene: Scene | None,
        dry_run: bool,
        emulated: bool = False,
        watchdog_s: float = 2.0,
    ) -> None:
        if watchdog_s < PATIENCE_S:
            raise SpecError(
                f"rig.watchdog_s = {watchdog_s:g} is shorter than the {PATIENCE_S:g} s that devices get to stop",
                hint=f"give {PATIENCE_S:g} or more",
            )
        self.resolved = tuple(resolved)
        self.clock = clock
        self.scene = scene
        self.dry_run = dry_run
        self.emulated = emulated
        self.watchdog: Watchdog | None = None
        self._watchdog_s = watchdog_s
        self.unstopped: list[str] = []
        """What the latest `safe_stop` could not stop, and why."""
        self.devices: dict[str, Device] = {}
        self.limits: dict[str, Limits] = {}
        for number, item in enumerate(resolved):
            rng = np.random.default_rng(np.random.SeedSequence((seed, _DEVICE_STREAM, number)))
            # A driver between the runner and an emulator knows nothing of the bench behind it.
            seen = scene if dry_run or item.plugin.startswith(STAND_IN) else None
            self.devices[item.name] = item.make(item.name, item.settings, DeviceContext(clock, rng, seen))
            self.limits[item.name] = item.settings.limits
        self.actuators = {name: d for name, d in self.devices.items() if isinstance(d, Actuator)}
        self.sensors = {name: d for name, d in self.devices.items() if isinstance(d, Sensor)}
        self.carriages = {name: d for name, d in self.devices.items() if isinstance(d, Carriage)}
        self.arranging = {name: d for name, d in self.devices.items() if isinstance(d, Arranging)}
        self.paced = {name: d for name, d in self.devices.items() if isinstance(d, Paced)}
        self.joints = _joints(self.actuators)
        self.calls = DeviceCalls(list(self.devices), self._tell_watchdog)
        """Surrounds every call of a device."""

    @classmethod
    def build(
        cls,
        experiment: Experiment,
        *,
        clock: Clock,
        seed: int,
        dry_run: bool,
        emulated: EmulatedBench | None = None,
        require_ports: bool = True,
    ) -> "Rig":
        """Make the devices of an experiment; connects nothing.

        Parameters
        ----------
        dry_run
            Stand-ins and the scene take the place of hardware.
        emulated
            Started emulators, which take the place of hardware behind the real drivers.
        require_ports
            Whether all ports have to be there; without, opening a device tells.

        Raises
        ------
        RequestError
            A driver or a port is missing, a plugin is unknown, a setting does not hold: all devices' problems at once.
        """
        resolved: list[ResolvedDevice] = []
        problems: list[LabrunError] = []
        for name, written in experiment.rig.devices.items():
            table = written if emulated is None else emulated.table(name)
            try:
                resolved.append(resolve_device(name, table, dry_run=dry_run))
            except RequestError as error:
                problems.append(error)
        if require_ports and not dry_run:
            missing = missing_ports({item.name: item.settings for item in resolved})
            hint = "plug it in, or set its port; --dry-run works without it"
            problems += [RequestError(text, hint=hint) for text in missing]
        if len(problems) == 1:
            raise problems[0]
        if problems:
            raise RequestError("\n".join(str(problem) for problem in problems))
        scene: Scene | None = None
        if emulated is not None:
            scene = emulated.scene
        elif dry_run or any(item.plugin.startswith(STAND_IN) for item in resolved):
            scene = _make_scene(experiment, seed)
        return cls(
            resolved,
            clock=clock,
            seed=seed,
            scene=scene,
            dry_run=dry_run,
            emulated=emulated is not None,
            watchdog_s=experiment.rig.watchdog_s,
        )

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.safe_stop()
        self.close()

    def open(self) -> None:
        """Connect every device; if some fail, disconnect the others and report all that failed at once.

        On hardware the watchdog starts first: nothing is driven that nobody else could stop.
        """
        if not self.dry_run:
            self.watchdog = start_watchdog(
                self.resolved, set(self.actuators) | set(self.carriages), self._watchdog_s
            )
        try:
            failures = self._each(self.devices, lambda device: device.open())
        except BaseException:  # Ctrl-C: nobody will come to close what is open
            self.safe_stop()
            self.close()
            raise
        if not failures:
            return
        self.close()
        if len(failures) == 1 and isinstance(failures[0][1], DeviceError):
            raise failures[0][1]
        names = ", ".join(name for name, _ in failures)
        raise DeviceError(
            names, "cannot be opened\n" + "\n".join(f"  {name}: {error}" for name, error in failures)
        )

    def close(self) -> None:
        """Disconnect every device, whatever each of them says; the watchdog stops what `safe_stop` could not."""
        self._close(self.devices)
        if self.watchdog is not None:
            if self.unstopped:
                self.watchdog.abandon()
            else:
                self.watchdog.end()
            self.watchdog = None

    def _close(self, devices: Mapping[str, Device]) -> None:
        """Disconnect devices, whatever each of them says; one that hangs is left behind."""
        if self.dry_run:
            self._each(devices, lambda device: device.close())
        else:
            at_once(devices, lambda device: device.close(), _CLOSING_S)

    def safe_stop(self) -> list[str]:
        """Stop all motion, at any moment, from any thread; never raises. Return what could not be stopped, and why."""
        failures = stop_all({**self.actuators, **self.carriages}, self.beat)
        self.unstopped = failures
        return failures

    def identities(self) -> dict[str, Identity]:
        """Return the identity of every device."""
        identities: dict[str, Identity] = {}
        for name, device in self.devices.items():
            with self.calls(name, "identify"):
                identities[name] = device.identify()
            if not isinstance(identities[name], Identity):
                raise wrong_answer(name, "identify", identities[name], "an Identity")
        return identities

    def arm(self) -> None:
        """Arm the watchdog: actuators may move from now on."""
        if self.watchdog is not None:
            self.watchdog.arm()

    def disarm(self) -> None:
        """Disarm the watchdog: nothing moves any more."""
        if self.watchdog is not None:
            self.watchdog.disarm()

    def beat(self) -> None:
        """Send a sign of life to the watchdog."""
        if self.watchdog is not None:
            self.watchdog.beat()

    def _tell_watchdog(self, number: int | None) -> None:
        if self.watchdog is not None:
            self.watchdog.calling(number)

    def reopen(self, name: str) -> None:
        """Reconnect a failed device; DeviceError if that fails."""
        self._close({name: self.devices[name]})
        with self.calls(name, "open"):
            self.devices[name].open()

    def reseed(self, seed: int, trial_index: int, *stretch: int) -> None:
        """Give every device that draws random numbers those of this trial, so that a resumed run repeats itself.

        A trial in stretches also has the number of the cycle at which one begins.
        """
        for number, device in enumerate(self.devices.values()):
            reseed = getattr(device, "reseed", None)
            if reseed is not None:
                reseed(np.random.SeedSequence((seed, trial_index, number, *stretch)))

    def snapshot(self) -> dict[str, Any]:
        """Return the memory of the scene, and of the devices that keep any, as JSON-ready values.

        Nothing outside a dry run: a bench in real time cannot be put back to where it was.
        """
        memory: dict[str, Any] = {}
        if not self.dry_run:
            return memory
        if self.scene is not None:
            if not self.sensors:  # nobody looks at it: it moves on here, and lets go of its past
                self.scene.observe(tuple(self.scene.signals), np.array([self.clock.now()]))
            memory["scene"] = self.scene.snapshot()
        devices = {name: d.snapshot() for name, d in self.devices.items() if hasattr(d, "snapshot")}
        if devices:
            memory["devices"] = devices
        return memory

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave."""
        if self.scene is not None and "scene" in memory:
            self.scene.restore(memory["scene"])
        for name, state in memory.get("devices", {}).items():
            restore = getattr(self.devices[name], "restore", None)
            if restore is not None:
                restore(state)

    @staticmethod
    def _each(devices: Mapping[str, Device], action: Callable[[Device], None]) -> list[tuple[str, Exception]]:
        failures: list[tuple[str, Exception]] = []
        for name, device in devices.items():
            try:
                action(device)
            except Exception as error:  # a driver may raise anything; the others still get their turn
                failures.append((name, error))
        return failures


def _joints(actuators: Mapping[str, Actuator]) -> dict[str, str]:
    joints: dict[str, str] = {}
    for name, actuator in actuators.items():
        for joint in actuator.joints:
            if joint in joints:
                raise SpecError(f"joint {joint} is moved by two devices, {joints[joint]} and {name}")
            joints[joint] = name
    return joints


def _make_scene(experiment: Experiment, seed: int) -> Scene:
    table = scene_of(experiment.rig)
    rng = np.random.default_rng(np.random.SeedSequence((seed, _SCENE_STREAM)))
    scene: Scene = load("labrun.scenes", table.plugin)(table.settings, rng)
    return scene
