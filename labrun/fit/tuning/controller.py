"""A PID controller's frequency response and difference equation, as `labrun.control.pid` computes it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a controller, in the drive's unit per unit of the feedback.

    Attributes
    ----------
    p, i_per_s, d_s
        Parallel form: ``p + i/s + d s / (filter_s s + 1)``.
    filter_s
        Time constant of the derivative's filter.
    feedforward
        What the drive is given per unit of reference: the inverse of the plant's static gain, or None.
    lead_s
        How far ahead on the reference the feed-forward looks.
    """

    p: float
    i_per_s: float = 0.0
    d_s: float = 0.0
    filter_s: float = 0.0
    feedforward: float | None = None
    lead_s: float = 0.0

    def scaled(self, factor: float) -> "Gains":
        """Return them with the feedback's gains times a factor."""
        return Gains(
            self.p * factor,
            self.i_per_s * factor,
            self.d_s * factor,
            self.filter_s,
            self.feedforward,
            self.lead_s,
        )

    def i_per_sample(self, rate_hz: float) -> float:
        """Return the integral gain that is summed once a sample."""
        return self.i_per_s / rate_hz

    def frequency_response(self, omega_rad_s: FloatArray, step_s: float) -> ComplexArray:
        """Return drive over error, shape of `omega_rad_s`; of samples `step_s` apart, or continuous if that is 0.

        The sum of errors includes the present one; the derivative is a filtered backward difference.
        """
        s = 1j * omega_rad_s
        if step_s == 0:
            return np.asarray(self.p + self.i_per_s / s + self.d_s * s / (self.filter_s * s + 1.0))
        change = -np.expm1(-s * step_s)  # 1 - 1/z
        share = step_s / (self.filter_s + step_s)
        rate = share * change / step_s / (1.0 - (1.0 - share) * (1.0 - change))
        return np.asarray(self.p + self.i_per_s * step_s / change + self.d_s * rate)

    def settings(self, period_s: float, i_per: str, model: dict[str, Any] | None) -> dict[str, Any]:
        """Return the keys of the controller plugin: ``pid``, or ``feedforward+pid`` where there is a feed-forward.

        Parameters
        ----------
        period_s
            Time from step to step, for an integral per sample.
        i_per
            ``"second"`` or ``"sample"``.
        model
            Keys of the model whose static gain the feed-forward inverts.
        """
        keys: dict[str, Any] = {"p": self.p}
        if self.i_per_s:
            keys |= {"i": self.i_per_s * (period_s if i_per == "sample" else 1.0), "i_per": i_per}
        if self.d_s:
            keys |= {"d": self.d_s, "filter_s": self.filter_s}
        if self.feedforward is not None:
            if model is None:
                raise ValueError("a feed-forward needs its model")
            keys |= {"model": dict(model)}
            if self.lead_s:
                keys |= {"lead_s": self.lead_s}
        return keys

    @property
    def plugin(self) -> str:
        """Name of the controller plugin that takes `settings`."""
        return "pid" if self.feedforward is None else "feedforward+pid"
