"""Stand-in for a slider that a tendon pulls and a spring brings back."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from labrun.devices import DeviceContext, DeviceSettings, Health, Trajectory
from labrun_plugins.simulated.device import SimulatedDevice, SimulatedSettings
from labrun_plugins.tendon_slider.changeover import SLIDER, Changeover
from labrun_plugins.tendon_slider.settings import TendonSliderSettings

_END = 0.02
"""Of its way: so near to an end its switch closes."""


class SimulatedTendonSliderSettings(TendonSliderSettings, SimulatedSettings):
    """Keys of the slider, and of every simulated device."""


class SimulatedTendonSlider(SimulatedDevice):
    """A slider that is where the bench has it: whether it arrives, the bench's signal ``slider`` says."""

    Settings: ClassVar[type[DeviceSettings]] = SimulatedTendonSliderSettings
    model = "slider on a tendon (simulated)"

    def __init__(self, name: str, settings: SimulatedTendonSliderSettings, context: DeviceContext) -> None:
        super().__init__(name, settings, context)
        self._change = Changeover(name, settings, context.clock, self._switches, self._hold)
        self._tendon = Trajectory((SLIDER,), np.zeros(1), np.zeros((1, 1)))
        self._start_s = 0.0

    def open(self) -> None:
        """Connect. Raises DeviceError: this bench has no slider."""
        self._require_signals((SLIDER,))
        self._change.withdraw()
        super().open()

    def health(self) -> Health:
        """Report no complaint unless it no longer answers, or the slider has left where it was verified to be."""
        health = super().health()
        complaint = self._change.complaint() if health.ok else None
        return health if complaint is None else Health(ok=False, notes=(complaint,))

    def arrange(self, condition: Mapping[str, float | str]) -> None:
        """Begin to move into the state that the coming trial's condition names; see the driver."""
        self._require_answer()
        now_s = self._clock.now()
        if self._change.want(condition):
            self._pull(self._change.path(self._pulled(now_s)), now_s)

    def arrived(self) -> bool:
        """Tell whether the switches say that the wanted state is reached; DeviceError if it takes too long."""
        self._require_answer()
        return self._change.arrived()

    def safe_stop(self) -> None:
        """Stop the servo where it is."""
        super().safe_stop()
        if not self.closed and self._scene is not None:
            self._hold()
            self._change.withdraw()

    def snapshot(self) -> dict[str, Any]:
        """Return the tendon's motion as JSON-ready values, so that a resumed run goes on identically."""
        return {
            "start_s": self._start_s,
            "time_s": self._tendon.time_s.tolist(),
            "pulled": self._tendon.angle_rad[:, 0].tolist(),
            "wanted": self._change.wanted,
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take back what `snapshot` gave; the bench restores its own memory of the slider."""
        self._start_s = float(snapshot["start_s"])
        pulled = np.array(snapshot["pulled"], dtype=float)[:, None]
        self._tendon = Trajectory((SLIDER,), np.array(snapshot["time_s"], dtype=float), pulled)
        self._change.wanted = snapshot["wanted"]

    def _pulled(self, time_s: float) -> float:
        return float(self._tendon.at(time_s - self._start_s)[0, 0])

    def _pull(self, motion: Trajectory, now_s: float) -> None:
        self._tendon, self._start_s = motion, now_s
        self.scene.drive(SLIDER, motion, now_s)

    def _hold(self) -> None:
        now_s = self._clock.now()
        here = Trajectory((SLIDER,), np.zeros(1), np.array([[self._pulled(now_s)]]))
        self._pull(here, now_s)

    def _switches(self) -> Sequence[bool]:
        position_m = float(self.scene.observe((SLIDER,), np.array([self._clock.now()]))[0, 0])
        return (position_m <= _END, position_m >= 1.0 - _END)
