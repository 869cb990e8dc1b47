"""The box: what it says about itself in ``/netftapi2.xml``; how it is asked by web pages, TCP, one sample over UDP."""

import fcntl
import http.client
import ipaddress
import math
import socket
import threading
from contextlib import closing, suppress
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.ati_netft import codec, strict_xml, units
from labrun_plugins.ati_netft.settings import BOX_RATE_HZ, AtiNetFtSettings
from labrun_plugins.ati_netft.source import DatagramSocket

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

    Raises BoxInfoError: it is no such XML, or a part of it is missing, given twice, or makes no sense.
    """
    try:
        root = strict_xml.parse(data, MOST_XML_BYTES)
    except strict_xml.XmlRefusedError as error:
        raise BoxInfoError(f"netftapi2.xml is {error}") from None
    force_unit, torque_unit = _required(root, "scfgfu"), _required(root, "scfgtu")
    if units.newtons_per(force_unit) is None:
        raise BoxInfoError(f"scfgfu = {force_unit!r} is not a known unit of force")
    if units.newton_metres_per(torque_unit) is None:
        raise BoxInfoError(f"scfgtu = {torque_unit!r} is not a known unit of torque")
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


def _optional(root: Element, name: str) -> str:
    elements = strict_xml.find_all(root, name)
    if len(elements) > 1:
        raise BoxInfoError(f"netftapi2.xml gives {name} {len(elements)} times")
    text = (elements[0].text or "").strip() if elements else ""
    if len(text) > _LONGEST_TEXT or not text.isprintable():
        raise BoxInfoError(f"{name} of netftapi2.xml is not a text of up to {_LONGEST_TEXT} letters")
    return text


def _required(root: Element, name: str) -> str:
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


def _counts(root: Element, name: str) -> float:
    value = _number(name, _required(root, name))
    if not value > 0.0:
        raise BoxInfoError(f"{name} = {value:g} counts per unit is not above 0")
    return value


_PATIENCE_S = 2.0
_LONGEST_S = 6.0
"""For a whole page: a box that sends a byte now and then must not hold anybody up."""
_MOST_PARTS = 8
_SIOCGIFADDR = 0x8915
_LONGEST_NAME = 15
_CABLE = "check its power and network cable, and `host`: it should answer ping, and its web page a browser"


def own_address(device: str, settings: AtiNetFtSettings) -> str:
    """Return the address of this computer to bind to: that of `interface`, else of the one that leads to the box.

    Raises DeviceError: there is no such interface, or no way to the box.
    """
    wanted = settings.interface
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as asking:
        if wanted is None:
            try:
                # sends nothing: the system looks up the way
                asking.connect((settings.host, settings.rdt_port))
            except OSError as error:
                raise DeviceError(
                    device, f"no route to {settings.host}: {error.strerror or error}", hint=_CABLE
                ) from None
            return str(asking.getsockname()[0])
        if _is_address(wanted):
            try:
                asking.bind((wanted, 0))
            except OSError:
                raise DeviceError(
                    device,
                    f"interface = {wanted!r} is not an address of this computer",
                    hint="`ip addr` lists them; leave `interface` out to take the one that leads to the box",
                ) from None
            return wanted
        try:
            name = wanted.encode()[:_LONGEST_NAME].ljust(32, b"\0")
            answer = fcntl.ioctl(asking.fileno(), _SIOCGIFADDR, name)
        except OSError:
            there = ", ".join(name for _, name in socket.if_nameindex())
            raise DeviceError(
                device,
                f"this computer has no interface {wanted!r} with an address",
                hint=f"interfaces: {there}; leave `interface` out to take the one that leads to {settings.host}",
            ) from None
        return socket.inet_ntoa(answer[20:24])


def fetch(device: str, settings: AtiNetFtSettings, own: str, path: str) -> bytes:
    """Return one of the box's web pages, no more of it than makes sense.

    Raises DeviceError: no answer, or not the page.
    """
    where = f"http://{settings.host}:{settings.http_port}{path.partition('?')[0]}"
    connection = http.client.HTTPConnection(
        settings.host, settings.http_port, timeout=_PATIENCE_S, source_address=(own, 0)
    )
    deadline = threading.Timer(_LONGEST_S, _hang_up, (connection,))
    deadline.daemon = True
    deadline.start()
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        body = answer.read(MOST_XML_BYTES + 1)
    except (OSError, http.client.HTTPException) as error:
        reason = "no answer" if isinstance(error, TimeoutError) else str(error) or type(error).__name__
        raise DeviceError(device, f"cannot read {where}: {reason}", hint=_CABLE) from None
    finally:
        deadline.cancel()
        connection.close()
    if answer.status != http.client.OK:
        raise DeviceError(
            device,
            f"{where} answers {answer.status}",
            hint="is this a Net F/T box? open its page in a browser",
        )
    return body


def ask_info(device: str, settings: AtiNetFtSettings, own: str) -> BoxInfo:
    """Return what the box says about itself; DeviceError if it does not, or nothing that can be used."""
    try:
        return parse(fetch(device, settings, own, "/netftapi2.xml"))
    except BoxInfoError as error:
        hint = f"open http://{settings.host}:{settings.http_port}/ in a browser and look at its configuration"
        raise DeviceError(device, str(error), hint=hint) from None


def set_rate(device: str, settings: AtiNetFtSettings, own: str) -> BoxInfo:
    """Have the box send at the wanted rate; return its set-up as it is then.

    Raises DeviceError: it does not answer, or still has another rate afterwards: it ignores what it does not
    understand.
    """
    wanted = round(box_rate(settings.rate_hz))
    fetch(device, settings, own, f"/comm.cgi?comrdtrate={wanted}")
    info = ask_info(device, settings, own)
    if abs(info.rate_hz - box_rate(wanted)) > 0.5:
        raise DeviceError(
            device,
            f"was set to send {wanted} samples/s, and still says {info.rate_hz:g}",
            hint=f"set its RDT output rate on http://{settings.host}/comm.htm, or leave set_rate out",
        )
    return info


def ask_tcp(settings: AtiNetFtSettings, own: str, request: bytes, answer_bytes: int) -> bytes:
    """Return the answer to one request over TCP; shorter than asked for if the box hangs up. OSError if it cannot."""
    address = (settings.host, settings.tcp_port)
    with socket.create_connection(address, _PATIENCE_S, source_address=(own, 0)) as connection:
        connection.sendall(request)
        answer = b""
        for _ in range(_MOST_PARTS):
            part = connection.recv(answer_bytes - len(answer))
            answer += part
            if not part or len(answer) == answer_bytes:
                break
        return answer


def _is_address(text: str) -> bool:
    try:
        ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return True


def _hang_up(connection: http.client.HTTPConnection) -> None:
    with suppress(OSError):
        if connection.sock is not None:
            connection.sock.shutdown(socket.SHUT_RDWR)


_TRIES = 4
_SAMPLE_S = 0.5
_LOOK_EVERY_S = 0.002


def ask_status(device: str, settings: AtiNetFtSettings, clock: Clock, own: str) -> int:
    """Return the status that comes with one sample.

    Raises DeviceError: no answer to any of a few requests: a datagram may get lost, four do not.
    """
    box = DatagramSocket(device, clock, own, (settings.host, settings.rdt_port))
    malformed = 0
    try:
        for _ in range(_TRIES):
            try:
                box.send(codec.request(codec.STREAM, 1))
            except OSError:
                clock.sleep(_SAMPLE_S)  # refused at once; it may be starting up
                continue
            until_s = clock.now() + _SAMPLE_S
            while clock.now() < until_s:
                clock.sleep(_LOOK_EVERY_S)
                try:
                    heard = box.take()
                except DeviceError:  # nobody listens on that port
                    clock.sleep(_SAMPLE_S)
                    break
                if len(heard):
                    records, _, bad = codec.decode_block(heard.slots, heard.length)
                    malformed += bad
                    if len(records):
                        return int(records["status"][-1])
    finally:
        box.close()
    malformed_note = f", but {malformed} datagrams of a wrong length" if malformed else ""
    raise DeviceError(
        device,
        f"no sample from {settings.host}, UDP port {settings.rdt_port}, to {_TRIES} requests{malformed_note}",
        hint="enable RDT on its web page (Communications), and let UDP pass the firewall of this computer",
    )
