"""What a look at Motive's set-up brings up."""

from labrun.devices import Remark
from labrun_plugins.optitrack.frame import Frame
from labrun_plugins.optitrack.messages import dotted
from labrun_plugins.optitrack.session import Session
from labrun_plugins.optitrack.settings import OptiTrackSettings

_SLOW_S = 0.02
_FAR_S = 0.005


def remarks(device: str, settings: OptiTrackSettings, session: Session, frame: Frame | None) -> list[Remark]:
    """Return remarks on rate, axes, layout, network, latency and the bodies in view."""
    found = [_rate(device, settings, session), _axis(device, settings), _layout(device, session)]
    found += _latency(device, session, frame)
    found += _bodies(device, settings, session, frame)
    return found


def _rate(device: str, settings: OptiTrackSettings, session: Session) -> Remark:
    if session.rate_hz is None:
        return Remark(
            "warning",
            device,
            "Motive does not tell its frame rate",
            f"see that it is {settings.rate_hz:g} frames/s",
        )
    return Remark("ok", device, f"{session.rate_hz:g} frames/s, as the file says")


def _axis(device: str, settings: OptiTrackSettings) -> Remark:
    if settings.up_axis is None:
        return Remark(
            "warning",
            device,
            "which axis points up is not stated, and NatNet does not tell",
            'see Up Axis in Motive\'s streaming pane, and add it to the file: up_axis = "y"',
        )
    return Remark("ok", device, f"axis {settings.up_axis} points up, as the file states")


def _layout(device: str, session: Session) -> Remark:
    version = dotted(session.layout)
    how = "multicast" if session.multicast else "unicast"
    if session.link.foreign:
        return Remark(
            "warning",
            device,
            f"{session.link.foreign} datagrams of {session.link.foreign_address} were ignored",
            "another server streams on this network; give it another group or port",
        )
    return Remark("ok", device, f"frames of NatNet {version} by {how} on interface {session.local}")


def _latency(device: str, session: Session, frame: Frame | None) -> list[Remark]:
    found = []
    latency_s = None if frame is None else session.latency_s(frame)
    if latency_s is not None:
        slow = latency_s > _SLOW_S
        found.append(
            Remark(
                "warning" if slow else "ok",
                device,
                f"{1e3 * latency_s:.1f} ms from exposure to transmission",
                "close views and programs on Motive's computer" if slow else "",
            )
        )
    offset = session.echoes.best()
    if offset is not None:
        far = offset.round_trip_s > _FAR_S
        found.append(
            Remark(
                "warning" if far else "ok",
                device,
                f"clock offset {offset.offset_s:.4f} s, known to {1e3 * offset.round_trip_s / 2:.2f} ms",
                "connect by cable, not by wireless" if far else "",
            )
        )
    return found


def _bodies(device: str, settings: OptiTrackSettings, session: Session, frame: Frame | None) -> list[Remark]:
    numbers = {body.name: body.id for body in session.bodies}
    measured = {} if frame is None else {body.id: body for body in frame.bodies if body.measured}
    found = []
    for name in settings.bodies:
        body = measured.get(numbers.get(name, -1))
        if body is None:
            advice = "see that cameras see its markers, and that it is switched on in Motive's assets pane"
            found.append(Remark("problem", device, f"body {name} is not tracked now", advice))
        else:
            found.append(
                Remark("ok", device, f"body {name} is tracked, markers fit to {1e3 * body.error_m:.2f} mm")
            )
    return found
