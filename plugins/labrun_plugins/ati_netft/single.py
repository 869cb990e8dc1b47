"""One sample, asked for on its own: whether the box is there, and well."""

from labrun.devices import Clock, DeviceError
from labrun_plugins.ati_netft import codec
from labrun_plugins.ati_netft.datagrams import DatagramSocket
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

_TRIES = 4
_PATIENCE_S = 0.5
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
                clock.sleep(_PATIENCE_S)  # refused at once; it may be starting up
                continue
            until_s = clock.now() + _PATIENCE_S
            while clock.now() < until_s:
                clock.sleep(_LOOK_EVERY_S)
                try:
                    heard = box.take()
                except DeviceError:  # nobody listens on that port
                    clock.sleep(_PATIENCE_S)
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
