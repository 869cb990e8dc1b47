"""What `labrun doctor --hardware` says about the arm."""

import math

import numpy as np

from labrun.devices import Remark
from labrun_plugins.ur5.line import Line
from labrun_plugins.ur5.rtde import RtdeClient
from labrun_plugins.ur5.settings import Ur5Settings
from labrun_plugins.ur5.state import ArmState, trouble_of
from labrun_plugins.ur5.tracking import Tracking

_RATE_SHARE = 0.02
_LOST_SHARE = 1e-3
_FREE_FORCE_N = 15.0
"""More than this at rest, hanging free, comes of a payload that is not the one set; the estimate is good to a few N."""
_REACH_M = 0.85


def remarks(
    settings: Ur5Settings,
    state: ArmState,
    tracking: Tracking,
    rtde: RtdeClient,
    remote: bool | None,
    travel_m: tuple[float, float],
) -> list[Remark]:
    """Return one remark for each thing looked at."""
    found = [_mode(state), _rate(tracking, rtde), _losses(tracking), _remote(remote), _slider(state)]
    if rtde.protocol == 1:
        found.append(Remark("warning", "RTDE", "speaks version 1 only", "update PolyScope"))
    if rtde.missing:
        found.append(
            Remark("warning", "RTDE", f"the controller has no {', '.join(rtde.missing)}", "update PolyScope")
        )
    found.append(_payload(state))
    found += _line(settings, tracking.line, travel_m)
    return found


def _mode(state: ArmState) -> Remark:
    trouble = trouble_of(state)
    if trouble is None:
        return Remark(
            "ok", "state", "running, safety normal" if state.safety_mode == 1 else "running, reduced"
        )
    return Remark("problem", "state", trouble.message, trouble.hint)


def _rate(tracking: Tracking, rtde: RtdeClient) -> Remark:
    reached = tracking.rate_hz()
    text = f"{reached:.1f} of {rtde.rate_hz:g} packages/s (controller {rtde.version_text})"
    if math.isfinite(reached) and abs(reached - rtde.rate_hz) <= _RATE_SHARE * rtde.rate_hz:
        return Remark("ok", "RTDE rate", text)
    return Remark(
        "warning",
        "RTDE rate",
        text,
        "close other RTDE clients, use a cable of its own, or ask for a lower rate_hz",
    )


def _losses(tracking: Tracking) -> Remark:
    made = tracking.received + tracking.lost
    text = f"{tracking.lost} of {made} packages lost, {tracking.stale} repeated"
    if tracking.lost <= max(1.0, _LOST_SHARE * made):
        return Remark("ok", "RTDE packages", text)
    return Remark(
        "warning",
        "RTDE packages",
        text,
        "the controller skips packages when it is busy: end URCaps and other clients",
    )


def _remote(remote: bool | None) -> Remark:
    if remote is None:
        return Remark("ok", "remote control", "not told by this controller (a CB3 always takes programs)")
    if remote:
        return Remark("ok", "remote control", "on")
    return Remark(
        "problem",
        "remote control",
        "off: the arm takes no programs",
        "switch to Remote Control on the pendant",
    )


def _slider(state: ArmState) -> Remark:
    text = f"{100 * state.slider:.0f} %, speed scaling {100 * state.speed_scaling:.0f} %"
    if state.slider >= 1.0:
        return Remark("ok", "speed slider", text)
    return Remark("problem", "speed slider", text, "set it to 100 %: moves are slower than the file says")


def _payload(state: ArmState) -> Remark:
    if state.force is None:
        return Remark("ok", "payload", "not checked: this controller does not tell its tool force")
    force_n = float(np.linalg.norm(state.force[:3]))
    if force_n <= _FREE_FORCE_N:
        return Remark("ok", "payload", f"the arm feels {force_n:.1f} N at its tool")
    return Remark(
        "warning",
        "payload",
        f"the arm feels {force_n:.1f} N at its tool at rest",
        "if it hangs free, set mass and centre of the payload on the pendant (Installation): a wrong one makes "
        "protective stops likely",
    )


def _line(settings: Ur5Settings, line: Line | None, travel_m: tuple[float, float]) -> list[Remark]:
    if line is None:
        return [Remark("warning", "line", "not known while the arm is not running")]
    found = []
    origin, turn = (
        ", ".join(f"{round(one, 4) + 0.0:.4f}" for one in v) for v in (line.origin_m, line.orientation_rad)
    )
    if settings.origin_m is None or settings.orientation_rad is None:
        found.append(
            Remark(
                "warning",
                "line",
                "position zero is wherever the tool stands when labrun connects: a run that is taken up again would "
                "begin elsewhere",
                f"jog the tool to the start and write down: origin_m = [{origin}], orientation_rad = [{turn}]",
            )
        )
    else:
        found.append(Remark("ok", "line", f"from [{origin}] m"))
    for end_m in travel_m:
        reach_m = float(np.linalg.norm(line.pose(end_m)[:3]))
        if reach_m > _REACH_M:
            found.append(
                Remark(
                    "warning",
                    "line",
                    f"its point at {end_m:g} m is {reach_m:.3f} m from the arm's base; a UR5 reaches {_REACH_M:g} m",
                    "shorten limits.travel_m, or move origin_m",
                )
            )
    return found
