"""Where records come from: the box itself, by this package's own client or by pynetft."""

from typing import Protocol

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.ati_netft import codec
from labrun_plugins.ati_netft.datagrams import DatagramSocket
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

_STOPS = 3


class Source(Protocol):
    """One stream of the box, from its start to its end; a new one is made for every start."""

    @property
    def malformed(self) -> int:
        """Datagrams that were none of the box's."""
        ...

    def start(self) -> None:
        """Ask for the stream; DeviceError if that cannot be."""
        ...

    def take(self) -> tuple[codec.Records, FloatArray]:
        """Return what has come since the last time and when, by the run's clock; does not wait."""
        ...

    def dropped(self) -> int:
        """Return how many records reached this computer and were lost in it."""
        ...

    def halt(self) -> None:
        """Ask for the stream's end; never raises, any thread."""
        ...

    def close(self) -> None:
        """Free what it holds; never raises."""
        ...


class BoxSource:
    """The own client: one socket for one stream, so that nothing of an earlier stream can come in between.

    Parameters
    ----------
    device, clock, settings
        Of the driver.
    own
        Address of this computer to bind to.
    """

    def __init__(self, device: str, clock: Clock, settings: AtiNetFtSettings, own: str) -> None:
        self.malformed = 0
        self._device = device
        self._command = codec.BUFFERED if settings.mode == "buffered" else codec.STREAM
        self._socket = DatagramSocket(device, clock, own, (settings.host, settings.rdt_port))

    def start(self) -> None:
        """Ask for the stream."""
        try:
            self._socket.send(codec.request(self._command))
        except OSError as error:
            raise DeviceError(
                self._device,
                f"cannot be reached: {error.strerror or error}",
                hint="check its power and network cable, and host",
            ) from None

    def take(self) -> tuple[codec.Records, FloatArray]:
        """Return what has come since the last time and when, by the run's clock; does not wait."""
        datagrams = self._socket.take()
        if not len(datagrams):
            return np.empty(0, codec.RECORD), np.empty(0)
        records, number, malformed = codec.decode_block(datagrams.slots, datagrams.length)
        self.malformed += malformed
        return records, datagrams.host_time_s[number]

    def dropped(self) -> int:
        """Return how many datagrams reached this computer and found no room."""
        return self._socket.dropped()

    def halt(self) -> None:
        """Ask for the stream's end, more than once: the request is not acknowledged and may get lost."""
        for _ in range(_STOPS):
            try:
                self._socket.send(codec.request(codec.STOP))
            except OSError:
                continue  # an earlier one met nobody; or closed already, or the network is gone

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
