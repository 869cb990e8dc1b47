"""Does the file name only what the rig has? Checked before anything moves."""

import inspect
from collections.abc import Iterable

from labrun.errors import SpecError, StoreError
from labrun.runner.rig import Rig
from labrun.runner.settle import tared_devices, watched_channels
from labrun.spec import LOOP_DEVICE, CarriageMove, Experiment
from labrun.store import check_columns, check_names

_ORDER_WITHOUT_RAMPS = 2
"""Parameters of a carriage's `travel` that takes goal and speed alone."""


def check_wiring(experiment: Experiment, rig: Rig, gait_joints: Iterable[str]) -> None:
    """Check every name in the file that stands for a joint, a channel or a device.

    Raises SpecError: all that the rig does not have, at once.
    """
    problems: list[str] = []
    channels = {f"{name}.{c.name}" for name, sensor in rig.sensors.items() for c in sensor.channels}
    if experiment.track is not None:
        channels |= {f"{LOOP_DEVICE}.{name}" for name in experiment.track.channels}
    problems += _unstorable(rig)
    for joint in gait_joints:
        problems += _unknown(f"gait.joints.{joint}", joint, rig.joints, "joints")
    for joint in experiment.trial.safe_pose_deg:
        problems += _unknown(f"trial.safe_pose_deg.{joint}", joint, rig.joints, "joints")
    if experiment.trial.carriage is not None:
        device = experiment.trial.carriage.device
        problems += _unknown("trial.carriage.device", device, rig.carriages, "carriages")
        problems += _ramps(experiment.trial.carriage, rig)
    for name, objective in experiment.objectives.items():
        if objective.channel is not None:
            problems += _unknown(f"objectives.{name}.channel", objective.channel, channels, "channels")
    try:
        if experiment.trial.settle is not None and experiment.trial.settle.until == "quiet":
            watched_channels(experiment.trial.settle, rig)
        tared_devices(experiment.trial.tare, rig)
    except SpecError as error:
        problems.append(str(error))
    if problems:
        raise SpecError("\n".join(problems))


def _ramps(move: CarriageMove, rig: Rig) -> list[str]:
    carriage = rig.carriages.get(move.device)
    if move.acceleration_m_s2 is None or carriage is None:
        return []
    if len(inspect.signature(carriage.travel).parameters) > _ORDER_WITHOUT_RAMPS:
        return []
    return [
        f"trial.carriage.acceleration_m_s2: {move.device!r} has ramps of its own that cannot be set; leave the key out"
    ]


def _unstorable(rig: Rig) -> list[str]:
    """Return what could not be stored under its name: better known before a trial than after it."""
    problems = []
    for name in rig.devices:
        try:
            channels = rig.sensors[name].channels if name in rig.sensors else ()
            check_names(name, [channel.name for channel in channels])
        except StoreError as error:
            problems.append(f"rig.devices.{name}: {error}")
    try:
        check_columns("joint", list(rig.joints))
    except StoreError as error:
        problems.append(str(error))
    return problems


def _unknown(key: str, name: str, known: Iterable[str], kind: str) -> list[str]:
    known = sorted(known)
    if name in known:
        return []
    return [f"{key}: {name!r} is not one of the rig's {kind}: {', '.join(known) or 'there are none'}"]
