"""Examine the machine and, with `--hardware`, the devices."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from labrun.app.run import behind_the_drivers
from labrun.devices import Remark
from labrun.errors import RequestError
from labrun.experiment import load_named
from labrun.runner import RealClock, Rig, SilentProgress, examine_machine, examine_rig, find_devices, ports_of
from labrun.store import lock_ports


def doctor(
    experiment: str | None = None,
    workspace: str | Path = ".",
    overrides: Sequence[str] = (),
    *,
    hardware: bool = False,
    emulate: bool = False,
) -> tuple[Remark, ...]:
    """Examine the machine or the devices; nothing is moved.

    Parameters
    ----------
    experiment
        Whose devices to look at; without one, whatever answers at the serial ports.
    workspace, overrides
        Where the experiment is looked for, and keys of its file to replace.
    hardware
        Look at devices at all.
    emulate
        Look at emulators of the experiment's devices.

    Raises
    ------
    RequestError
        An experiment that does not hold, or options that do not go together.
    RigBusyError
        A run holds the devices.
    """
    return tuple(examine(experiment, workspace, overrides, hardware=hardware, emulate=emulate))


def examine(
    experiment: str | None,
    workspace: str | Path,
    overrides: Sequence[str],
    *,
    hardware: bool,
    emulate: bool,
) -> Iterator[Remark]:
    """Yield the remarks of `doctor` one by one, because a bench answers slowly."""
    if (experiment is not None or emulate) and not hardware:
        raise RequestError(
            "an experiment or --emulate needs --hardware", hint="add --hardware; nothing is moved"
        )
    if emulate and experiment is None:
        raise RequestError(
            "--emulate needs an experiment, whose devices it emulates", hint="labrun list shows them"
        )
    if not hardware:
        yield from examine_machine()
    elif experiment is None:
        yield from find_devices()
    else:
        yield from _examine_devices(experiment, Path(workspace), overrides, emulate)


def _examine_devices(name: str, workspace: Path, overrides: Sequence[str], emulate: bool) -> Iterator[Remark]:
    loaded = load_named(name, workspace, overrides)
    with behind_the_drivers(
        loaded.experiment, seed=0, emulate=emulate, progress=SilentProgress()
    ) as emulated:
        rig = Rig.build(
            loaded.experiment,
            clock=RealClock(),
            seed=0,
            dry_run=False,
            emulated=emulated,
            require_ports=False,
        )
        ports = [] if emulate else [port for item in rig.resolved for port in ports_of(item.settings)]
        with lock_ports(ports):
            yield from examine_rig(rig)
