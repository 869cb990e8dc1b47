"""The calibration file of an ATI sensor: from six voltages to forces and torques.

ATI's own C code (``ftconfig.c``): M[i][j] = values[j] / scale of axis i, load = M (V - V_bias). The matrix already
refers to the calibrated origin; ``BasicTransform`` says where that is and is not applied again.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from labrun.devices import FloatArray
from labrun_plugins.ati_daq.settings import GAUGES
from labrun_plugins.ati_netft import strict_xml, units

MOST_BYTES = 262_144
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
_LONGEST_TEXT = 200
_TOLD = (
    "Serial", "BodyStyle", "Family", "NumGages", "CalFileVersion", "PartNumber", "CalDate", "ForceUnits",
    "TorqueUnits", "DistUnits", "OutputMode", "OutputRange", "HWTempComp", "GainMultiplier", "OutputBipolar",
)  # fmt: skip


class CalibrationError(ValueError):
    """A calibration file cannot be used; the message says which part of it and why."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A sensor's calibration, in SI units.

    Attributes
    ----------
    matrix : (6, 6)
        From volts to N and N m, a row an axis: force x, y, z, torque x, y, z.
    maximum : (6,)
        End of the range of each axis, N and N m.
    attributes
        What else the file says: serial number, date, temperature compensation ...
    """

    matrix: FloatArray
    maximum: FloatArray
    attributes: dict[str, str] = field(default_factory=dict)

    @property
    def serial(self) -> str:
        """The sensor's serial number; empty if the file does not name it."""
        return self.attributes.get("Serial", "")

    def load(self, voltages: FloatArray, bias_v: FloatArray) -> FloatArray:
        """Return forces (N) and torques (N m), shape (n, 6), of voltages, shape (n, 6)."""
        result: FloatArray = (voltages - bias_v) @ self.matrix.T
        return result


def read(path: Path) -> Calibration:
    """Return the calibration in a file; CalibrationError if it cannot be used."""
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise CalibrationError(error.strerror or str(error)) from None
    return parse(data)


def parse(data: bytes) -> Calibration:
    """Return the calibration in the bytes of a ``.cal`` file.

    Raises CalibrationError: it is no such file, an axis or a unit is missing or given twice, or a number makes no
    sense.
    """
    try:
        root = strict_xml.parse(data, MOST_BYTES)
    except strict_xml.XmlRefusedError as error:
        raise CalibrationError(f"it is not the XML of a calibration: {error}") from None
    if root.tag.lower() != "ftsensor":
        raise CalibrationError(f"it begins with <{root.tag[:40]}>, expected <FTSensor>")
    calibrations = strict_xml.find_all(root, "Calibration")
    if len(calibrations) != 1:
        raise CalibrationError(f"it holds {len(calibrations)} calibrations, one is expected")
    attributes = _attributes(root, calibrations[0])
    gauges = attributes.get("NumGages", str(GAUGES))
    if gauges.strip() != str(GAUGES):
        raise CalibrationError(f"NumGages = {gauges!r}: only sensors with {GAUGES} gauges are supported")
    force, torque = _unit(attributes, "ForceUnits"), _unit(attributes, "TorqueUnits")
    axes = _axes(calibrations[0])
    si = np.array([force] * 3 + [torque] * 3)
    matrix = np.array([_row(axes[name], name) for name in AXES]) * si[:, None]
    maximum = np.array([_positive(axes[name], "max", name) for name in AXES]) * si
    if not np.isfinite(matrix).all() or not np.isfinite(maximum).all():
        raise CalibrationError("a number in it is too large")
    if np.linalg.matrix_rank(matrix / np.maximum(np.abs(matrix).max(axis=1, keepdims=True), 1e-300)) < GAUGES:
        raise CalibrationError(
            "its six axes do not separate six loads: two of them are multiples of each other"
        )
    return Calibration(matrix, maximum, attributes)


def _attribute(element: Element, name: str) -> str | None:
    values = [value for key, value in element.items() if key.lower() == name.lower()]
    if len(values) > 1:
        raise CalibrationError(f"<{element.tag}> gives {name} {len(values)} times")
    return values[0] if values else None


def _attributes(root: Element, calibration: Element) -> dict[str, str]:
    attributes = {}
    for name in _TOLD:
        for element in (root, calibration):
            value = _attribute(element, name)
            if value is not None:
                if len(value) > _LONGEST_TEXT or not value.isprintable():
                    raise CalibrationError(f"{name} is not a text of up to {_LONGEST_TEXT} letters")
                attributes[name] = value
    for element in strict_xml.find_all(calibration, "BasicTransform"):
        values = (f"{key} {value[:20]}" for key, value in sorted(element.items()) if value.isprintable())
        attributes["BasicTransform"] = ", ".join(values)[:_LONGEST_TEXT]
    return attributes


def _unit(calibration_table: dict[str, str], name: str) -> float:
    text = calibration_table.get(name)
    if text is None:
        raise CalibrationError(f"it does not give {name}")
    value = units.newtons_per(text) if name == "ForceUnits" else units.newton_metres_per(text)
    if value is None:
        raise CalibrationError(f"{name} = {text!r} is not known")
    return value


def _axes(calibration: Element) -> dict[str, Element]:
    axes: dict[str, Element] = {}
    for element in strict_xml.find_all(calibration, "Axis"):
        name = (_attribute(element, "Name") or "").lower()
        if name not in AXES or name in axes:
            raise CalibrationError(
                f"axis {name[:20]!r} is given twice, or is not one of Fx, Fy, Fz, Tx, Ty, Tz"
            )
        axes[name] = element
    missing = [name.capitalize() for name in AXES if name not in axes]
    if missing:
        raise CalibrationError(f"axis {', '.join(missing)} is missing")
    return axes


def _row(axis: Element, name: str) -> list[float]:
    values = [_number(text, name, "values") for text in (_attribute(axis, "values") or "").split()]
    if len(values) != GAUGES:
        raise CalibrationError(f"axis {name.capitalize()} has {len(values)} values, {GAUGES} are expected")
    scale = 1.0 if _attribute(axis, "scale") is None else _positive(axis, "scale", name)
    return [value / scale for value in values]


def _positive(axis: Element, attribute: str, name: str) -> float:
    value = _number(_attribute(axis, attribute) or "", name, attribute)
    if not value > 0.0:
        raise CalibrationError(f"{attribute} of axis {name.capitalize()} is {value:g}; it should be above 0")
    return value


def _number(text: str, axis: str, attribute: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CalibrationError(f"{attribute} of axis {axis.capitalize()}: {text[:20]!r} is not a number")
    return value
