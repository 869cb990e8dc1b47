"""What `labrun doctor --hardware` says about a sensor on a card: rate, losses, voltages, calibration."""

from collections.abc import Iterator

import numpy as np

from labrun.devices import Remark
from labrun_plugins.ati_daq.calibration import Calibration
from labrun_plugins.ati_daq.reception import Reception
from labrun_plugins.ati_daq.settings import AtiDaqSettings

_RATE_TOLERANCE = 0.02
_NEAR_RAIL = 0.9


def examine(
    reception: Reception, calibration: Calibration, settings: AtiDaqSettings, rate_hz: float
) -> list[Remark]:
    """Judge what has been sampled for a while.

    Parameters
    ----------
    rate_hz
        What the card says.
    """
    return [*_stream(reception, settings, rate_hz), *_calibration(calibration, settings)]


def _stream(reception: Reception, settings: AtiDaqSettings, rate_hz: float) -> Iterator[Remark]:
    measured = reception.rate_hz()
    if abs(measured / rate_hz - 1.0) > _RATE_TOLERANCE:
        advice = "this computer cannot keep up, or the card has another clock: lower rate_hz"
        yield Remark("warning", "rate", f"{measured:.5g} samples/s, the card says {rate_hz:.5g}", advice)
    else:
        yield Remark("ok", "rate", f"{measured:.5g} samples/s, the card says {rate_hz:.5g}")
    verdict = f"{reception.lost} of {reception.received + reception.lost} samples lost"
    yield Remark(
        "warning" if reception.lost else "ok", "losses", verdict, "lower rate_hz" if reception.lost else ""
    )
    gauge = int(np.argmax(reception.peak_v))
    message = f"the greatest is {reception.peak_v[gauge]:.3g} V, of gauge {gauge + 1}"
    if reception.peak_v[gauge] > _NEAR_RAIL * settings.range_v:
        advice = "unload the sensor; a gauge that stays there is not connected, or the sensor is damaged"
        yield Remark("problem", "voltages", message, advice)
    elif not reception.peak_v.all():
        silent = ", ".join(str(i + 1) for i in np.flatnonzero(reception.peak_v == 0.0))
        yield Remark("problem", "voltages", f"gauge {silent} reads 0 V exactly", "check wiring and `input`")
    else:
        yield Remark("ok", "voltages", message)


def _calibration(calibration: Calibration, settings: AtiDaqSettings) -> Iterator[Remark]:
    told = calibration.told
    said = ", ".join(
        f"{key} {told[key]}" for key in ("Serial", "PartNumber", "CalDate", "HWTempComp") if key in told
    )
    yield Remark("ok", "calibration", said or "the file names no sensor", "compare with the sensor's label")
    output = " ".join(told[key] for key in ("OutputMode", "OutputRange") if key in told)
    if output:
        advice = f"should fit wiring = {settings.wiring!r} and inputs of +-{settings.range_v:g} V"
        yield Remark("ok", "output", f"the file says: {output}", advice)
