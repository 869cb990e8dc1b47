"""The library pynetft as the source of records, kept from what goes wrong with it.

It stops at the first fault instead of reconnecting in secret, its queue holds a second of samples, every record is
handed on with its status, and its `bias` is not used: on a running stream it ends the delivery for ever.
"""

from collections import deque
from contextlib import suppress
from typing import Any

import numpy as np

from labrun.devices import Clock, DeviceError, FloatArray
from labrun_plugins.ati_netft import codec
from labrun_plugins.ati_netft.settings import AtiNetFtSettings

_QUEUE = 8192


class PynetftSource:
    """One stream by way of pynetft.

    Parameters
    ----------
    rate_hz
        At which the box sends.

    Raises
    ------
    DeviceError
        It is not installed, or asked for what it cannot do.
    """

    def __init__(self, device: str, clock: Clock, settings: AtiNetFtSettings, rate_hz: float) -> None:
        try:
            import pynetft
        except ImportError:
            raise DeviceError(
                device, 'client = "pynetft" needs the library pynetft', hint="pip install 'labrun[netft]'"
            ) from None
        if settings.mode == "buffered" or settings.interface is not None:
            what = 'mode = "buffered"' if settings.mode == "buffered" else "an interface"
            raise DeviceError(
                device, f"pynetft cannot use {what}", hint='leave client out: client = "labrun" can'
            )
        self._device = device
        self._clock = clock
        self._faults: type[Exception] = pynetft.NetFTError
        self._samples: deque[Any] = deque(maxlen=4 * _QUEUE)
        config = pynetft.Config(
            sensor_host=settings.host,
            rdt_port=settings.rdt_port,
            http_port=settings.http_port,
            receive_timeout=max(1e-3 * settings.silence_ms, 5.0 / rate_hz),
            deliver_samples_with_error_status=True,
            recovery_policy=pynetft.RecoveryPolicy.FAIL_STOP,
        )
        self._client = pynetft.Client(config, queue_size=_QUEUE, callback=self._samples.append)

    @property
    def malformed(self) -> int:
        """Datagrams that were none of the box's."""
        return int(self._client.health().malformed_count)

    def start(self) -> None:
        """Ask for the stream."""
        try:
            self._client.start()
        except (self._faults, OSError) as error:
            raise DeviceError(
                self._device,
                f"pynetft cannot start: {error}",
                hint="check its power and network cable, and host",
            ) from None

    def take(self) -> tuple[codec.Records, FloatArray]:
        """Return what has come since the last time and when, by the run's clock; does not wait."""
        count = len(self._samples)
        if not count:
            try:
                self._client.raise_if_failed()
            except self._faults as error:
                raise DeviceError(
                    self._device,
                    f"pynetft has given up: {error.__cause__ or error}",
                    hint="check its power and network cable, and that no other program reads the box",
                ) from None
            return np.empty(0, codec.RECORD), np.empty(0)
        taken = [self._samples.popleft() for _ in range(count)]
        rows = [(s.rdt_sequence, s.ft_sequence, s.status, s.raw_wrench) for s in taken]
        return np.array(rows, codec.RECORD), 1e-9 * np.array([s.received_at_ns for s in taken], dtype=float)

    def dropped(self) -> int:
        """Return how many samples found the library's queue full."""
        return int(self._client.health().python_queue_dropped_count)

    def halt(self) -> None:
        """End the stream."""
        with suppress(Exception):  # whatever a library raises, a stop goes on
            self._client.stop()

    def close(self) -> None:
        """End the stream."""
        self.halt()
