"""What `labrun doctor --hardware` looks at on an opened stage."""

import datetime
from typing import Protocol

from labrun.devices import Clock, Remark, Samples
from labrun_plugins.labline.session import Hello, LineSession
from labrun_plugins.linear_stage.codec import Flags, StageState, is_saturated
from labrun_plugins.linear_stage.reception import complaints
from labrun_plugins.linear_stage.settings import LinearStageSettings

_LISTEN_S = 1.0
_RATE_SLACK = 0.15
"""The HX711's own oscillator is good to some ten per cent."""
_OLD_DAYS = 365
_POOR_RESIDUAL = 0.01


class Streaming(Protocol):
    """What is needed of the driver."""

    rate_hz: float

    def start(self) -> None:
        """Begin to stream."""
        ...

    def read(self) -> Samples:
        """Return the samples since the last call."""
        ...

    def stop(self) -> None:
        """End the stream."""
        ...


def examine(
    stage: Streaming,
    hello: Hello,
    state: StageState,
    settings: LinearStageSettings,
    session: LineSession,
    clock: Clock,
) -> list[Remark]:
    """Return what was found; moves nothing, streams for a second."""
    found = [
        Remark("ok", "firmware", f"{hello.kind} {hello.firmware}, up to {hello.max_rate_hz:g} samples/s"),
        _watchdog(settings),
        *_state(state, settings),
        _calibration(settings),
    ]
    found += _stream(stage, settings, clock)
    if session.counts.rejected:
        found.append(
            Remark(
                "warning",
                "line",
                f"{session.counts.rejected} damaged lines of {session.counts.accepted}",
                "shorten the USB cable, and keep it away from the motor's wires",
            )
        )
    return found


def _watchdog(settings: LinearStageSettings) -> Remark:
    message = f"stops by itself after {settings.watchdog_ms} ms of silence"
    if settings.watchdog_ms > 100:
        advice = "watchdog_ms = 100 keeps a stage whose runner died from pushing on"
        return Remark("warning", "watchdog", message, advice)
    return Remark("ok", "watchdog", message)


def _state(state: StageState, settings: LinearStageSettings) -> list[Remark]:
    notes = complaints(state.flags, homes=settings.home_on_open)
    if not notes and Flags.HOMED in state.flags:
        return [Remark("ok", "state", f"homed, at {state.position_mm:.3f} mm, {state.counts} counts")]
    if not notes:
        homing = "not homed yet: a run begins by seeking the lower end switch, and nothing may be in its way"
        return [Remark("ok", "state", f"{homing}; {state.counts} counts")]
    return [Remark("problem", "state", note, "see the README of the plugin linear-stage") for note in notes]


def _calibration(settings: LinearStageSettings) -> Remark:
    calibration = settings.calibration
    if calibration is None:
        return Remark(
            "warning", "calibration", "none: there are counts, and no forces",
            "hang five masses or more on the cell, and put masses_kg and counts into its table",
        )  # fmt: skip
    line = calibration.line
    of_range = settings.limits.force_n or abs(line.slope_n_per_count) * 2.0**22
    told = f"{line.slope_n_per_count:.4g} N/count, {line.offset_counts:.0f} counts without load"
    if line.residual_n is not None and line.residual_n > _POOR_RESIDUAL * of_range:
        return Remark(
            "warning", "calibration", f"{told}; its points scatter by {line.residual_n:.2g} N",
            "calibrate anew: the cell creeps, slips or was loaded off its axis",
        )  # fmt: skip
    if calibration.date is None:
        return Remark("warning", "calibration", f"{told}; without a date", "write the date into its table")
    age = (datetime.datetime.now(datetime.UTC).date() - calibration.date).days
    if age > _OLD_DAYS:
        return Remark("warning", "calibration", f"{told}; {age} days old", "calibrate anew")
    return Remark("ok", "calibration", f"{told}; of {calibration.date}")


def _stream(stage: Streaming, settings: LinearStageSettings, clock: Clock) -> list[Remark]:
    stage.start()
    try:
        clock.sleep(_LISTEN_S)
        samples = stage.read()
    finally:
        stage.stop()
    if len(samples) < 3:
        return [
            Remark(
                "problem",
                "load cell",
                f"{len(samples)} samples in {_LISTEN_S:g} s",
                "check supply, DOUT and SCK of the HX711",
            )
        ]
    device_s = samples.device_time_s
    rate_hz = (len(samples) + samples.lost - 1) / float(device_s[-1] - device_s[0])
    counts = samples.values[:, -1]
    message = (
        f"{rate_hz:.1f} samples/s by its own clock, {samples.lost} lost, "
        f"counts {counts.mean():.0f} with a spread of {counts.std():.0f}"
    )
    if any(is_saturated(int(one)) for one in counts):
        return [
            Remark("problem", "load cell", message, "it is at the end of its range: check its four wires")
        ]
    if abs(rate_hz - settings.rate_hz) > _RATE_SLACK * settings.rate_hz:
        advice = "set rate_hz as the RATE pin of the HX711 says: low 10, high 80"
        return [Remark("warning", "load cell", message, advice)]
    return [Remark("ok", "load cell", message)]
