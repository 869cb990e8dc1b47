"""The network towards the box: this computer's address, the box's web pages, its TCP port, and one sample over UDP."""

import fcntl
import http.client
import ipaddress
import socket
import threading
from contextlib import closing, suppress

from labrun.devices import Clock, DeviceError
from labrun_plugins.ati_netft import box_info, codec
from labrun_plugins.ati_netft.datagrams import DatagramSocket
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

_PATIENCE_S = 2.0
_LONGEST_S = 6.0
"""For a whole page: a box that sends a byte now and then must not hold anybody up."""
_MOST_PARTS = 8
_SIOCGIFADDR = 0x8915
_LONGEST_NAME = 15
_CABLE = "check its power and network cable, and `host`: it should answer ping, and its web page a browser"


def own_address(device: str, settings: AtiNetFtSettings) -> str:
    """Return the address of this computer to bind to: that of `interface`, else of the one that leads to the box.

    Raises
    ------
    DeviceError
        There is no such interface, or no way to the box.
    """
    wanted = settings.interface
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as asking:
        if wanted is None:
            try:
                asking.connect(
                    (settings.host, settings.rdt_port)
                )  # sends nothing: the system looks up the way
            except OSError as error:
                raise DeviceError(
                    device, f"there is no way to {settings.host}: {error.strerror or error}", hint=_CABLE
                ) from None
            return str(asking.getsockname()[0])
        if _is_address(wanted):
            try:
                asking.bind((wanted, 0))
            except OSError:
                raise DeviceError(
                    device,
                    f"interface = {wanted!r} is no address of this computer",
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

    Raises
    ------
    DeviceError
        No answer, or not the page.
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
        body = answer.read(box_info.MOST_XML_BYTES + 1)
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


def ask_info(device: str, settings: AtiNetFtSettings, own: str) -> box_info.BoxInfo:
    """Return what the box says about itself; DeviceError if it does not, or nothing that can be used."""
    try:
        return box_info.parse(fetch(device, settings, own, "/netftapi2.xml"))
    except box_info.BoxInfoError as error:
        hint = f"open http://{settings.host}:{settings.http_port}/ in a browser and look at its configuration"
        raise DeviceError(device, str(error), hint=hint) from None


def set_rate(device: str, settings: AtiNetFtSettings, own: str) -> box_info.BoxInfo:
    """Have the box send at the wanted rate; return its set-up as it is then.

    Raises
    ------
    DeviceError
        It does not answer, or still has another rate afterwards: it ignores what it does not understand.
    """
    wanted = round(box_info.box_rate(settings.rate_hz))
    fetch(device, settings, own, f"/comm.cgi?comrdtrate={wanted}")
    info = ask_info(device, settings, own)
    if abs(info.rate_hz - box_info.box_rate(wanted)) > 0.5:
        raise DeviceError(
            device,
            f"was told to send {wanted} samples/s, and still says {info.rate_hz:g}",
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

    Raises
    ------
    DeviceError
        No answer to any of a few requests: a datagram may get lost, four do not.
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
    found = f", but {malformed} datagrams of a wrong length" if malformed else ""
    raise DeviceError(
        device,
        f"no sample from {settings.host}, UDP port {settings.rdt_port}, to {_TRIES} requests{found}",
        hint="enable RDT on its web page (Communications), and let UDP pass the firewall of this computer",
    )
