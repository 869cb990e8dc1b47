"""The loop over time, sample by sample: the controller plugin of the bench on the exact plant."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.control import FeedforwardPid, LoopContext, PidController, Step
from labrun.fit.tuning.loop import Gains, OpenLoop, SampledPlant, sample_plant

UNBOUNDED = (-1e12, 1e12)
"""A range that bounds nothing."""


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
    """Run the controller plugin of the bench on a plant with a rate, from rest at the drive `start`.

    `reference` and `load` are functions of time, s; `bounds` is the range the drive is clamped to, and the load is
    added behind that.
    """
    step_s = loop.step_s
    count = round(duration_s / step_s) + 1
    controller = make_controller(gains, loop, bounds, start)
    plant = _Stepper(loop.sampled, sample_plant(loop.plant, step_s, extra_s=loop.compute_s), count, start)
    time_s: FloatArray = np.arange(count, dtype=float) * step_s
    wanted = np.array([reference(float(t)) for t in time_s])
    seen, drives, drive = np.empty(count), np.empty(count), start
    for k, now_s in enumerate(time_s.tolist()):
        seen[k] = plant.feedback(k)
        asked = controller.update(Step(now_s, step_s, float(wanted[k]), float(seen[k]), drive, reference))
        drive = drives[k] = min(max(asked, bounds[0]), bounds[1])
        controller.applied(drive)
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
