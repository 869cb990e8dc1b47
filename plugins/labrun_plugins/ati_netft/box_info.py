"""What the box says about itself in ``/netftapi2.xml``: units, counts per unit, rate, serial number."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labrun.devices import FloatArray
from labrun_plugins.ati_netft import strict_xml, units
from labrun_plugins.ati_netft.settings import BOX_RATE_HZ

MOST_XML_BYTES = 65_536
_LONGEST_TEXT = 100


class BoxInfoError(ValueError):
    """What the box says cannot be used; the message says which part and why."""


@dataclass(frozen=True, slots=True)
class BoxInfo:
    """Its set-up.

    Attributes
    ----------
    counts_per_force, counts_per_torque
        In its own units, `force_unit` and `torque_unit`.
    rate_hz
        At which it sends: 7000/n.
    buffer_size
        Records in one datagram of the buffered mode.
    run_status
        Its status word when it was asked, as text; empty if it does not say.
    """

    product: str
    serial: str
    counts_per_force: float
    counts_per_torque: float
    force_unit: str
    torque_unit: str
    rate_hz: float
    buffer_size: int
    run_status: str

    def si_per_count(self) -> FloatArray:
        """Return what one count of each axis is, N and N m, shape (6,)."""
        force = (units.newtons_per(self.force_unit) or math.nan) / self.counts_per_force
        torque = (units.newton_metres_per(self.torque_unit) or math.nan) / self.counts_per_torque
        return np.array([force] * 3 + [torque] * 3)

    def to_si(self, counts: NDArray[np.integer]) -> FloatArray:
        """Return counts as N and N m, shape (n, 6)."""
        values: FloatArray = counts.astype(float) * self.si_per_count()
        return values


def box_rate(wanted_hz: float) -> float:
    """Return the rate nearest to the wanted one that the box has: it keeps every n-th of its own samples."""
    return BOX_RATE_HZ / max(1, round(BOX_RATE_HZ / wanted_hz))


def parse(data: bytes) -> BoxInfo:
    """Return what a box's XML says.

    Raises
    ------
    BoxInfoError
        It is no such XML, or a part of it is missing, given twice, or makes no sense.
    """
    try:
        root = strict_xml.parse(data, MOST_XML_BYTES)
    except strict_xml.XmlRefusedError as error:
        raise BoxInfoError(f"netftapi2.xml is {error}") from None
    force_unit, torque_unit = _required(root, "scfgfu"), _required(root, "scfgtu")
    if units.newtons_per(force_unit) is None:
        raise BoxInfoError(f"scfgfu = {force_unit!r} is no known unit of force")
    if units.newton_metres_per(torque_unit) is None:
        raise BoxInfoError(f"scfgtu = {torque_unit!r} is no known unit of torque")
    rate = _number("comrdtrate", _optional(root, "comrdtrate") or f"{BOX_RATE_HZ:g}")
    if not 1.0 <= rate <= BOX_RATE_HZ:
        raise BoxInfoError(f"comrdtrate = {rate:g} is outside 1 to {BOX_RATE_HZ:g} Hz")
    return BoxInfo(
        product=_required(root, "prodname"),
        serial=_optional(root, "setserial"),
        counts_per_force=_counts(root, "cfgcpf"),
        counts_per_torque=_counts(root, "cfgcpt"),
        force_unit=force_unit,
        torque_unit=torque_unit,
        rate_hz=box_rate(rate),
        buffer_size=int(min(max(_number("comrdtbsiz", _optional(root, "comrdtbsiz") or "40"), 1.0), 40.0)),
        run_status=_optional(root, "runstat"),
    )


def _optional(root: strict_xml.Element, name: str) -> str:
    found = root.find_all(name)
    if len(found) > 1:
        raise BoxInfoError(f"netftapi2.xml gives {name} {len(found)} times")
    text = found[0].text if found else ""
    if len(text) > _LONGEST_TEXT or not text.isprintable():
        raise BoxInfoError(f"{name} of netftapi2.xml is no text of up to {_LONGEST_TEXT} letters")
    return text


def _required(root: strict_xml.Element, name: str) -> str:
    text = _optional(root, name)
    if not text:
        raise BoxInfoError(f"netftapi2.xml does not give {name}")
    return text


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BoxInfoError(f"{name} = {text!r} is not a number")
    return value


def _counts(root: strict_xml.Element, name: str) -> float:
    value = _number(name, _required(root, name))
    if not value > 0.0:
        raise BoxInfoError(f"{name} = {value:g} counts per unit is not above 0")
    return value
