"""One sensor under watch: every sample is checked as it comes in."""

import math

import numpy as np

from labrun.devices import Clock, Excess, Limits, Samples, Sensor
from labrun.errors import LimitExceededError
from labrun.runner.faults import NonsenseError, SilentDeviceError, blaming

_SILENT_PERIODS = 5.0
_SILENT_S = 0.5
_PLAUSIBLE = {
    "N": 1e6,
    "N m": 1e6,
    "rad": 1e5,
    "rad/s": 1e6,
    "m": 1e4,
    "m/s": 1e4,
    "degC": 1e3,
    "V": 1e6,
    "A": 1e5,
}
"""Beyond these a value is no measurement of a laboratory bench, but garbage from the wire."""
_PLAUSIBLE_OTHER = 1e12


class SensorWatch:
    """Reads a sensor, and raises what is wrong as an error that names the device.

    Parameters
    ----------
    name
        The device's name in the file.
    limits
        Bounds on its samples by unit.
    """

    def __init__(self, name: str, sensor: Sensor, limits: Limits, clock: Clock) -> None:
        self.name = name
        self.sensor = sensor
        self._limits = limits
        self._clock = clock
        self._silence_s = max(_SILENT_PERIODS / sensor.rate_hz, _SILENT_S)
        self._last_s = -math.inf
        bounds = {"N": limits.force_n, "N m": limits.torque_n_m, "degC": limits.temperature_c}
        ceiling = []
        for channel in sensor.channels:
            plausible = _PLAUSIBLE.get(channel.unit, _PLAUSIBLE_OTHER)
            bound = bounds.get(channel.unit)
            ceiling.append(plausible if bound is None else min(plausible, bound))
        self._ceiling = np.array(ceiling)
        self._plausible = np.array([_PLAUSIBLE.get(c.unit, _PLAUSIBLE_OTHER) for c in sensor.channels])
        self.running = False

    def start(self) -> None:
        """Begin to stream."""
        with blaming(self.name):
            self.sensor.start()
        self._last_s = self._clock.now()
        self.running = True

    def stop(self) -> None:
        """End the stream."""
        if self.running:
            self.running = False
            with blaming(self.name):
                self.sensor.stop()

    def read(self) -> Samples:
        """Return the samples since the last look.

        Raises
        ------
        SilentDeviceError
            No sample for longer than five periods (at least 0.5 s).
        NonsenseError
            Not finite, beyond anything plausible, of a wrong shape, or with time running backwards.
        LimitExceededError
            A sample beyond the device's limits; names channel, value, bound and time.
        """
        with blaming(self.name):
            block = self.sensor.read()
        now_s = self._clock.now()
        if len(block) == 0:
            quiet_s = now_s - self._last_s
            if quiet_s > self._silence_s:
                raise SilentDeviceError(
                    self.name,
                    f"stopped answering: no sample for {quiet_s:.2g} s at {self.sensor.rate_hz:g} samples/s",
                    hint="check its cable and power; labrun resume goes on once it answers",
                )
            return block
        self._check_shape(block)
        self._last_s = float(block.host_time_s[-1])
        # One comparison covers NaN, infinity, plausibility and limits; what exactly is wrong is found only when it is.
        if not (np.abs(block.values).max(axis=0) <= self._ceiling).all():
            self._check_values(block)
        return block

    def _check_shape(self, block: Samples) -> None:
        count = len(block.host_time_s)
        wanted = (count, len(self.sensor.channels))
        if block.values.shape != wanted or len(block.device_time_s) != count:
            raise NonsenseError(
                self.name,
                f"answered a block of shape {block.values.shape} with {len(block.device_time_s)} device times "
                f"and {count} host times; expected {wanted}",
                hint="this is a fault of its driver",
            )
        if (
            not math.isfinite(float(block.host_time_s[-1]))
            or block.host_time_s[0] < self._last_s - self._silence_s
        ):
            raise NonsenseError(self.name, "its samples' receive times run backwards or are not finite")

    def _check_values(self, block: Samples) -> None:
        bad = ~(np.abs(block.values) <= self._plausible)
        if bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0])
            channel = self.sensor.channels[column]
            nonsense = NonsenseError(
                self.name,
                f"answered nonsense: {channel.name} = {block.values[row, column]:g} {channel.unit}",
                hint="check its wiring, its supply and its driver's settings",
            )
            nonsense.clock_s = float(block.host_time_s[row])
            raise nonsense
        for excess in self._limits.sample_excess(self.sensor.channels, block.host_time_s, block.values):
            raise limit_error(self.name, excess)


def limit_error(device: str, excess: Excess, *, time_s: float | None = None) -> LimitExceededError:
    """Return the error for a limit that was left while the rig was moving."""
    error = LimitExceededError(
        device,
        str(excess),
        hint="actuators are stopped; look at the bench before labrun resume, or change the limit in the file",
    )
    error.clock_s = excess.time_s if time_s is None else time_s
    return error
