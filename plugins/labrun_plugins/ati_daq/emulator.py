"""A data acquisition card with a sensor on it, as a program that serves voltages (``reader = "socket"``) shows it.

The card itself has no wire that could be imitated: NI's driver talks to it. So the reader is exchanged and everything
behind it is real. What the sensor feels comes from its stand-in and its scene; the voltages from the inverse of the
calibration matrix, of the file the settings name, or of a made-up one if there is none.

Faults of the wire come from its endpoint (silence, late, half-frame, corrupt, fragment, coalesce ...). Of the card:

- ``overrun`` (count): samples were overwritten before they were fetched: the count jumps by 100.
- ``saturate``: a load beyond the range on all axes.
- ``open-gauge``: gauge 3 is not connected and stands at the rail.
- ``nonsense``: voltages that are not numbers.
- ``restart`` (count): the count begins anew.
- ``unplug``: the connection ends, and nothing listens until the fault ends.
"""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from labrun.devices import DeviceContext, FloatArray
from labrun.devices.emulated_ports import TcpEndpoint
from labrun.devices.emulation import NEVER, EmulatorContext
from labrun_plugins.simulated.ati_daq import SimulatedAtiDaq, SimulatedAtiDaqSettings

_HOST = "127.0.0.1"
_BATCH_S = 0.01
_MOST_AT_ONCE = 4096
_PATIENCE_MS = 500.0
_OFFSET_V = np.array([0.31, -0.22, 0.15, -0.4, 0.08, 0.27])
"""What the gauges read without a load."""
_RAIL_V = 10.0
_LONGEST_LINE = 200


class AtiDaqEmulator:
    """Serves one client at a time."""

    def __init__(self, name: str, settings: SimulatedAtiDaqSettings, context: EmulatorContext) -> None:
        self._settings = settings
        self._context = context
        self._clock, self._faults, self._log = context.clock, context.faults, context.log
        self._sensor = SimulatedAtiDaq(
            name, settings, DeviceContext(context.clock, context.rng, context.scene)
        )
        if context.scene is not None:
            self._sensor.open()
        self._file = settings.calibration_file
        self._made: Path | None = None
        self._volts_per_load: FloatArray = np.eye(6)
        self._endpoint = TcpEndpoint(context, _HOST)
        self._port = 0
        self._plugged = False
        self._asked: dict[int, bytes] = {}
        self._client: int | None = None
        self._rate_hz = settings.rate_hz
        self._start_s = 0.0
        self._next = 0
        self._count_from = 0

    def open(self) -> Mapping[str, Any]:
        """Open the port; make a calibration file if there is none."""
        if not self._file.is_file():
            self._made = self._file = self._context.folder / "emulated.cal"
            self._file.write_text(made_up_calibration(self._context.rng), encoding="utf-8")
        self._volts_per_load = np.asarray(np.linalg.inv(_matrix(self._file)), dtype=float)
        self._sensor.measure(np.array([self._clock.now()]))  # compiled before anybody waits for samples
        self._plug()
        reached_by: dict[str, Any] = {
            "reader": "socket", "server": _HOST, "server_port": self._port, "calibration_file": str(self._file),
        }  # fmt: skip
        if "silence_ms" not in self._settings.model_fields_set:
            reached_by["silence_ms"] = _PATIENCE_MS
        return reached_by

    def files(self) -> Sequence[int]:
        """Return the sockets to wait on."""
        return self._endpoint.fds if self._plugged else []

    def step(self, now_s: float) -> float:
        """Take orders, and send the samples that are due."""
        if self._faults.active("unplug"):
            self._unplug()
            return NEVER
        if not self._plugged:
            self._plug()
        self._endpoint.accept()
        for client, data in self._endpoint.receive():
            *lines, rest = (self._asked.pop(client, b"") + data).split(b"\n")
            if not data or len(rest) > _LONGEST_LINE:
                self._leave(client)
                continue
            self._asked[client] = rest
            for line in lines:
                self._obey(client, line)
        due_s = NEVER
        if self._client is not None:
            self._stream(now_s)
            due_s = now_s + _BATCH_S
        return min(due_s, self._endpoint.flush(self._clock.now()))

    def close(self) -> None:
        """Close the port, and take the made-up file away."""
        self._unplug()
        if self._made is not None:
            self._made.unlink(missing_ok=True)

    def _obey(self, client: int, line: bytes) -> None:
        word, _, rate = line.decode("ascii", "replace").partition(" ")
        if word == "stop":
            self._log.note("stop", how="request")
            self._leave(client)
            return
        try:
            wanted = float(rate) if word == "start" else 0.0
        except ValueError:
            wanted = 0.0
        if not 0.0 < wanted <= 1e5:
            self._log.note("rejected", message=line)
            self._leave(client)
            return
        self._log.note("start", rate_hz=wanted)
        self._client = client
        # A card divides its time base, 80 MHz, by a whole number.
        self._rate_hz = 80e6 / round(80e6 / wanted)
        self._start_s, self._next, self._count_from = self._clock.now(), 0, 0
        self._endpoint.send(client, f"voltages {self._rate_hz:.17g} NI-emulated 0C0FFEE\n".encode())

    def _stream(self, now_s: float) -> None:
        if self._client is None:
            return
        count = min(int((now_s - self._start_s) * self._rate_hz) - self._next, _MOST_AT_ONCE)
        if count <= 0:
            return
        number = self._next + np.arange(count)
        self._next += count
        if self._faults.take("overrun"):
            self._count_from += 100
        if self._faults.take("restart"):
            self._count_from = -int(number[0])
        volts = self._volts(self._start_s + number / self._rate_hz)
        head = struct.pack(">4sIQ", b"LRV1", count, int(number[0]) + self._count_from)
        self._endpoint.send(self._client, head + volts.astype(">f8").tobytes())

    def _volts(self, time_s: FloatArray) -> FloatArray:
        loads = self._sensor.measure(time_s)[0]
        if self._faults.active("saturate"):
            loads = np.broadcast_to(1.05 * np.array([20.0, 20.0, 60.0, 1.0, 1.0, 1.0]), loads.shape)
        volts: FloatArray = np.clip(loads @ self._volts_per_load.T + _OFFSET_V, -_RAIL_V, _RAIL_V)
        if self._faults.active("open-gauge"):
            volts[:, 2] = _RAIL_V
        if self._faults.active("nonsense"):
            volts[:, 4] = np.nan
        return volts

    def _leave(self, client: int) -> None:
        self._asked.pop(client, None)
        if client == self._client:
            self._client = None
        self._endpoint.drop(client)

    def _plug(self) -> None:
        self._endpoint = TcpEndpoint(self._context, _HOST, self._port)
        self._port = self._endpoint.open()
        self._plugged = True

    def _unplug(self) -> None:
        if self._plugged:
            self._plugged, self._client = False, None
            self._asked.clear()
            self._endpoint.close()


def made_up_calibration(rng: np.random.Generator) -> str:
    """Return a calibration file of no sensor that exists: well-conditioned, 4 V at the end of each range."""
    rotation, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    ends = np.array([20.0, 20.0, 60.0, 1.0, 1.0, 1.0])
    matrix = ends[:, None] / 4.0 * rotation
    scales = (2.5, 2.5, 1.25, 80.0, 80.0, 75.0)
    axes = "".join(
        f'<Axis Name="{name}" values="{" ".join(f"{value * scale:.12g}" for value in row)}" '
        f'max="{end:g}" scale="{scale:g}"/>\n'
        for name, row, end, scale in zip(
            ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), matrix, ends, scales, strict=True
        )
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<FTSensor Serial="FT00001" BodyStyle="Mini40" Family="DAQ" NumGages="6" CalFileVersion="1.1">\n'
        '<Calibration PartNumber="SI-20-1" CalDate="1/1/2000" ForceUnits="N" TorqueUnits="N-m" DistUnits="m" '
        'OutputMode="Ground Referenced Differential" OutputRange="20" HWTempComp="True">\n'
        f'{axes}<BasicTransform Dx="0" Dy="0" Dz="0.006" Rx="0" Ry="0" Rz="0"/>\n'
        "</Calibration>\n</FTSensor>\n"
    )


def _matrix(path: Path) -> FloatArray:
    """Return loads per volt (N, N m), in the file's order of axes, which must be Fx to Tz; newtons alone are known."""
    calibration = ElementTree.parse(path).getroot().find("Calibration")  # noqa: S314  see the import
    if calibration is None:
        raise ValueError(f"{path} holds no calibration")
    torque = {"N-m": 1.0, "Nm": 1.0, "N-mm": 1e-3, "Nmm": 1e-3}[calibration.get("TorqueUnits", "N-m")]
    rows = {
        axis.get("Name"): np.array((axis.get("values") or "").split(), dtype=float)
        / float(axis.get("scale", "1"))
        for axis in calibration.findall("Axis")
    }
    si = (1.0, 1.0, 1.0, torque, torque, torque)
    return np.array(
        [rows[name] * unit for name, unit in zip(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), si, strict=True)]
    )
