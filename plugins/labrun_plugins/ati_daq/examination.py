"""What `labrun doctor --hardware` says about a sensor on a card: rate, losses, voltages, calibration."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from labrun.devices import Remark

if TYPE_CHECKING:
    from labrun_plugins.ati_daq.driver import AtiDaq

_LISTEN_S = 1.0
_LOOK_EVERY_S = 0.02
_RATE_TOLERANCE = 0.02
_NEAR_RAIL = 0.9


def examine(device: "AtiDaq") -> list[Remark]:
    """Sample for a second; DeviceError if that fails."""
    return [*_stream(device), *_calibration(device)]


def _stream(device: "AtiDaq") -> Iterator[Remark]:
    own_start = device.reception is None
    if own_start:
        device.start()
    try:
        until_s = device.clock.now() + _LISTEN_S
        while device.clock.now() < until_s:
            device.clock.sleep(_LOOK_EVERY_S)
            device.read() if own_start else device.health()
        reception = device.reception
    finally:
        if own_start:
            device.stop()
    assert reception is not None  # noqa: S101  it ran
    measured = reception.rate_hz()
    if abs(measured / device.rate_hz - 1.0) > _RATE_TOLERANCE:
        advice = "this computer cannot keep up, or the card has another clock: lower rate_hz"
        yield Remark(
            "warning", "rate", f"{measured:.5g} samples/s, the card says {device.rate_hz:.5g}", advice
        )
    else:
        yield Remark("ok", "rate", f"{measured:.5g} samples/s, the card says {device.rate_hz:.5g}")
    verdict = f"{reception.lost} of {reception.received + reception.lost} samples lost"
    yield Remark(
        "warning" if reception.lost else "ok", "losses", verdict, "lower rate_hz" if reception.lost else ""
    )
    gauge = int(np.argmax(reception.peak_v))
    message = f"the greatest is {reception.peak_v[gauge]:.3g} V, of gauge {gauge + 1}"
    if reception.peak_v[gauge] > _NEAR_RAIL * device.settings.range_v:
        advice = "unload the sensor; a gauge that stays there is not connected, or the sensor is damaged"
        yield Remark("problem", "voltages", message, advice)
    elif not reception.peak_v.all():
        silent = ", ".join(str(i + 1) for i in np.flatnonzero(reception.peak_v == 0.0))
        yield Remark("problem", "voltages", f"gauge {silent} reads 0 V exactly", "check wiring and `input`")
    else:
        yield Remark("ok", "voltages", message)


def _calibration(device: "AtiDaq") -> Iterator[Remark]:
    told = device.calibration.told
    said = ", ".join(
        f"{key} {told[key]}" for key in ("Serial", "PartNumber", "CalDate", "HWTempComp") if key in told
    )
    yield Remark("ok", "calibration", said or "the file names no sensor", "compare with the sensor's label")
    output = " ".join(told[key] for key in ("OutputMode", "OutputRange") if key in told)
    if output:
        advice = (
            f"should fit wiring = {device.settings.wiring!r} and inputs of +-{device.settings.range_v:g} V"
        )
        yield Remark("ok", "output", f"the file says: {output}", advice)
