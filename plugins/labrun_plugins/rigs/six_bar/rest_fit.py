"""The fit ``six-bar-rest``: where the linkage rests, period and decay of its swing, and how well its loop closes."""

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, NonNegativeFloat
from scipy.optimize import OptimizeWarning, curve_fit

from labrun.devices import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit import (
    Curve,
    Dataset,
    FigureData,
    FitJob,
    FitSummary,
    FittedData,
    FitTrial,
    OutputsAlone,
    Panel,
    Stack,
    WithSettings,
    load_dataset,
    mean_estimate,
)
from labrun.models import Model, Output, load_model, simulate
from labrun.toml import Keys
from labrun_plugins.rigs.six_bar.linkage import JOINTS, loop_opening

_SWINGING = ("theta_5", "theta_6")
"""The joints of the end-effector, whose swing the source looks at."""


class RestSettings(Keys):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    skip_s
        Beginning of a trial that is left out: the faster motions die out there.
    """

    skip_s: NonNegativeFloat = 2.0


_LOOK = "look at the trial with labrun show; release the hinge farther from its rest, or lower skip_s"
_MEASURED = OutputsAlone(tuple(Output(joint, "rad") for joint in JOINTS))


@dataclass(frozen=True)
class Swing:
    """``rest + exp(-decay t) (a cos + b sin)(2 pi t / period)``: rad, 1/s, s.

    Attributes
    ----------
    amplitude, noise
        At the beginning, and what is left beside the swing (root mean square), rad.
    """

    rest: float
    decay: float
    period: float
    amplitude: float
    noise: float


class RestFit(WithSettings[RestSettings]):
    """Each trial by itself; estimates are means over trials with t-intervals."""

    Settings: ClassVar[type[BaseModel]] = RestSettings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit.

        Raises
        ------
        RequestError
            A model that has no loop.
        FitError
            A trial in which the end-effector does not swing, or by less than the noise.
        """
        data = load_dataset(job.target, _MEASURED, job.signals)
        model = job.model if job.model is not None else load_model("six-bar")
        if not set(JOINTS) <= set(model.states):
            raise RequestError(
                f"model {model.name} is not a linkage with the joints {JOINTS[0]} to {JOINTS[-1]}",
                hint="experiments/models/six-bar.toml is one",
            )
        job.note("following the swing of every joint")
        swings = [swings_of(trial, self._settings.skip_s) for trial in data.trials]
        rest = np.array([[s.rest for s in own] for own in swings])
        parameters = {
            f"rest_{joint}": mean_estimate(rest[:, column], "rad") for column, joint in enumerate(JOINTS)
        }
        for joint in _SWINGING:
            own = [joint_swings[JOINTS.index(joint)] for joint_swings in swings]
            parameters[f"period_{joint}"] = mean_estimate([s.period for s in own], "s")
            parameters[f"decay_{joint}"] = mean_estimate([s.decay for s in own], "1/s")
        job.note("simulating the swing")
        return FitSummary(
            method="six-bar-rest",
            model_name=model.name,
            data=FittedData.of(data),
            parameters=parameters,
            findings=_closures(model, data, rest),
            figure_data=lambda: _figure(data, rest),
        )


def swing(time_s: FloatArray, angle: FloatArray) -> Swing:
    """Return rest, decay and period of a decaying oscillation. Raises FitError: there is none."""
    middle = angle - angle.mean()
    spectrum = np.abs(np.fft.rfft(middle * np.hanning(len(middle))))
    frequencies = np.fft.rfftfreq(len(middle), float(np.mean(np.diff(time_s))))
    begin = 2 * np.pi * frequencies[1 + int(np.argmax(spectrum[1:]))]
    t = time_s - time_s[0]
    start = [float(angle.mean()), 0.3, begin, float(np.ptp(angle)) / 2, 0.0]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)
            coefficients, _ = curve_fit(_decaying, t, angle, start, maxfev=4000)
    except (RuntimeError, OptimizeWarning) as error:
        raise FitError(f"no decaying oscillation is found: {error}") from error
    rest, decay, speed, a, b = coefficients.tolist()
    noise = float(np.sqrt(np.mean((angle - _decaying(t, *coefficients)) ** 2)))
    return Swing(rest, decay, 2 * np.pi / abs(speed), float(np.hypot(a, b)), noise)


def _decaying(t: FloatArray, rest: float, decay: float, speed: float, a: float, b: float) -> FloatArray:
    return np.asarray(rest + np.exp(-decay * t) * (a * np.cos(speed * t) + b * np.sin(speed * t)))


def swings_of(trial: FitTrial, skip_s: float) -> list[Swing]:
    """Return the swing of every joint after `skip_s`. Raises FitError: those of the end-effector cannot be told."""
    late = trial.time_s >= trial.time_s[0] + skip_s
    if np.count_nonzero(late) < 100:
        raise FitError(
            f"{trial.label} has nothing left after its first {skip_s:g} s",
            hint="record longer, or set skip_s",
        )
    swings = []
    for joint, angle in zip(JOINTS, trial.outputs[late].T, strict=True):
        try:
            own = swing(trial.time_s[late], angle)
        except FitError as error:
            raise FitError(f"{trial.label}, {joint}: {error}", hint=_LOOK) from error
        if joint in _SWINGING and not own.amplitude > own.noise:
            raise FitError(
                f"{trial.label}, {joint}: after {skip_s:g} s it swings by {own.amplitude:.2g} rad, which is lost in "
                f"noise of {own.noise:.2g} rad",
                hint=_LOOK,
            )
        swings.append(own)
    return swings


def _closures(model: Model, data: Dataset, rest: FloatArray) -> tuple[str, ...]:
    """Say how far the loop is open: as measured at rest, and while the model swings from where each trial began."""
    order = [model.states.index(joint) for joint in JOINTS]
    measured = float(np.max(loop_opening(rest)))
    free = model.with_initial(dict.fromkeys(JOINTS, "first"))
    widest = 0.0
    for trial in data.trials:
        first = dict(zip(JOINTS, trial.outputs[:3].mean(axis=0).tolist(), strict=True))
        start = free.initial_state(trial.condition, first=first)
        nothing = np.empty((len(trial.time_s), 0))
        simulated = simulate(
            free, trial.time_s, nothing, condition=trial.condition, initial_state=start, substeps=2
        )
        angles = simulated.states[:: max(len(simulated.states) // 500, 1), order]
        widest = max(widest, float(np.max(loop_opening(angles))))
    predicted = model.with_initial(dict.fromkeys(JOINTS, "rest")).initial_state(data.trials[0].condition)
    apart = np.abs(rest.mean(axis=0) - predicted[order])
    worst = JOINTS[int(np.argmax(apart))]
    return (
        f"{model.name} as stated rests {apart.mean():.4f} rad from the measured angles in the mean, "
        f"{apart.max():.4f} rad at {worst}",
        f"the measured angles at rest leave its loop open by {1e3 * measured:.2f} mrad at most",
        f"simulated from where every trial began, the loop is open by {widest:.1e} rad at most",
    )


def _figure(data: Dataset, rest: FloatArray) -> FigureData:
    """Return the angles of the first trial over time with the angles at rest."""
    trial = data.trials[0]
    step = max(len(trial.time_s) // 2000, 1)
    t = trial.time_s[::step] - trial.time_s[0]
    stacks = []
    for column, joint in enumerate(JOINTS):
        at_rest = np.full(2, rest[:, column].mean())
        curves = (
            Curve(t, trial.outputs[::step, column], "measured", "measured" if column == 0 else ""),
            Curve(t[[0, -1]], at_rest, "fitted", "at rest" if column == 0 else ""),
        )
        panel = Panel(curves, x_label="time, s", y_label=f"{joint}, rad")
        stacks.append(Stack((panel,), width=1.0))
    title = f"Six-bar linkage let go: {data.name}\n{trial.label}"
    return FigureData(title, (tuple(stacks[:3]), tuple(stacks[3:])), row_height_in=2.8)
