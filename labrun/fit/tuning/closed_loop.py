"""A PID controller's gains, and the closed loop in time: the controller that runs on the bench, on the exact plant."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.control import FeedforwardPid, LoopContext, PidController, Step
from labrun.fit.tuning.loop import OpenLoop, SampledPlant, sample_plant

ComplexArray = NDArray[np.complex128]
UNBOUNDED = (-1e12, 1e12)
"""A range that bounds nothing."""


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
        return replace(self, p=self.p * factor, i_per_s=self.i_per_s * factor, d_s=self.d_s * factor)

    def i_per_sample(self, rate_hz: float) -> float:
        """Return the integral gain that is summed once a sample."""
        return self.i_per_s / rate_hz

    def steady_error(self, gain: float) -> float:
        """Return what is left of a constant reference, relative to it: ``(1 - K F) / (1 + K p)``, 0 with an integral.

        `gain`: K, the plant's static gain; F is the feed-forward's, 0 without one.
        """
        if self.i_per_s:
            return 0.0
        return (1.0 - gain * (self.feedforward or 0.0)) / (1.0 + gain * self.p)

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


@dataclass(frozen=True, slots=True)
class LoopResponse:
    """A closed loop over time, all of shape (n,).

    Attributes
    ----------
    time_s
        Times of the loop's steps.
    reference, output, feedback
        In the plant's output unit; the output at the steps, and what the controller was told of it.
    drive
        What was set, within its range.
    """

    time_s: FloatArray
    reference: FloatArray
    output: FloatArray
    feedback: FloatArray
    drive: FloatArray


class _Stepper:
    """A sampled plant that is stepped; it begins at rest."""

    def __init__(self, plant: SampledPlant, output: SampledPlant, count: int, drive: float) -> None:
        self._plant, self._output = plant, output
        self._before = max(tap.whole for tap in (*plant.taps, *output.taps))
        self._states = np.zeros((count + self._before + 1, len(plant.input)))
        self._drives = np.full(count + self._before + 1, drive)
        self._states[0] = plant.at_rest(drive)
        for k in range(self._before):  # the integral of an output at rest grows
            self._advance(k)

    def feedback(self, k: int) -> float:
        """Return the sample of step k; the drives before it are set."""
        k += self._before
        total = 0.0
        for tap in self._plant.taps:
            total += float(tap.from_state @ self._states[k - tap.whole])
            total += tap.from_drive * float(self._drives[k - tap.whole])
        return total

    def drive(self, k: int, value: float) -> None:
        """Hold a drive from step k to the next."""
        self._drives[k + self._before] = value
        self._advance(k + self._before)

    def outputs(self, count: int) -> FloatArray:
        """Return the output at all steps."""
        total = np.zeros(count)
        for tap in self._output.taps:
            rows = slice(self._before - tap.whole, self._before - tap.whole + count)
            total += self._states[rows] @ tap.from_state + tap.from_drive * self._drives[rows]
        return total

    def _advance(self, row: int) -> None:
        self._states[row + 1] = (
            self._plant.transition @ self._states[row] + self._plant.input * self._drives[row]
        )


def run_loop(
    gains: Gains,
    loop: OpenLoop,
    reference: Callable[[float], float],
    duration_s: float,
    *,
    bounds: tuple[float, float] = UNBOUNDED,
    start: float = 0.0,
    load: Callable[[float], float] | None = None,
) -> LoopResponse:
    """Run a controller on the plant, from rest at the drive `start`.

    Parameters
    ----------
    gains
        For the plugin that the bench runs, which is what is run here.
    loop
        With a rate.
    reference
        Of time, s.
    bounds
        Range of the drive, as the loop clamps it.
    load
        Of time; is added to the drive behind the clamp.
    """
    step_s = loop.step_s
    count = round(duration_s / step_s) + 1
    controller = make_controller(gains, loop, bounds, start)
    plant = _Stepper(loop.sampled, sample_plant(loop.plant, step_s, extra_s=loop.compute_s), count, start)
    time_s: FloatArray = np.arange(count, dtype=float) * step_s
    wanted = np.array([reference(float(t)) for t in time_s])
    seen, drives = np.empty(count), np.empty(count)
    drive = start
    for k in range(count):
        now_s = float(time_s[k])
        seen[k] = plant.feedback(k)
        asked = controller.update(Step(now_s, step_s, float(wanted[k]), float(seen[k]), drive, reference))
        drive = min(max(asked, bounds[0]), bounds[1])
        controller.applied(drive)
        drives[k] = drive
        plant.drive(k, drive if load is None else drive + load(now_s))
    return LoopResponse(time_s, wanted, plant.outputs(count), seen, drives)


def make_controller(gains: Gains, loop: OpenLoop, bounds: tuple[float, float], start: float) -> PidController:
    """Return the controller plugin with these gains."""
    context = LoopContext(loop.step_s, bounds[0], bounds[1], start)
    if gains.feedforward is None:
        return PidController(gains.settings(loop.step_s, "second", None), context)
    model = {"gain": 1.0 / gains.feedforward, "lag_s": 0.0, "dead_s": 0.0}
    return FeedforwardPid(gains.settings(loop.step_s, "second", model), context)


@dataclass(frozen=True, slots=True)
class StepFigures:
    """What a step of the reference leads to.

    Attributes
    ----------
    overshoot
        Of the output beyond the value it ends at, relative to the step; 0 if there is none.
    settling_s
        After which the output stays within 2 % of the step around the value it ends at; inf if it does not.
    steady_error
        What is left of the step, relative to it.
    peak_drive
        Largest drive per unit of the step, in the drive's unit per unit of the reference.
    """

    overshoot: float
    settling_s: float
    steady_error: float
    peak_drive: float


def step_figures(track: LoopResponse, steady_error: float) -> StepFigures:
    """Return the figures of a unit step's track; `steady_error` is known from the static gains."""
    end = 1.0 - steady_error
    beyond = float(np.max(track.output)) - end if end >= 0 else end - float(np.min(track.output))
    outside = np.flatnonzero(np.abs(track.output - end) > 0.02)
    last = -1 if len(outside) == 0 else int(outside[-1])
    settling_s = float(track.time_s[last + 1]) if last + 1 < len(track.time_s) else np.inf
    peak = float(track.drive[int(np.argmax(np.abs(track.drive)))])
    return StepFigures(max(beyond, 0.0), settling_s, steady_error, peak)


def horizon_s(loop: OpenLoop, gains: Gains | None = None) -> float:
    """Return how long a step is followed: many times what delays and lags it."""
    slow = 2.0 * loop.delay_s + float(np.sum(loop.lags_s))
    if gains is not None and gains.i_per_s:
        # the slow tail of a weak integral
        slow = max(slow, abs((1.0 + gains.p * loop.gain) / (gains.i_per_s * loop.gain)))
    return 12.0 * slow
