"""The fit ``swimming-speed``: at which speed a towed fish's thrust meets its drag, from its net force over speed.

On the arm thrust and drag are one force: what the sensor feels is thrust less drag. Where a parabola through it,
measured at several speeds, passes zero, the fish would swim by itself with the arm's mount on its back (source,
section 6.5, estimate of the speed: there two fitted curves were made to meet).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from labrun.devices import FloatArray
from labrun.errors import FitError
from labrun.fit import (
    Curve,
    Estimate,
    FigureData,
    FitJob,
    FitSummary,
    FittedData,
    FitTrial,
    OutputsAlone,
    Panel,
    Stack,
    load_dataset,
)
from labrun.models import Output

_RESAMPLES = 1000
_FEWEST_SPEEDS = 3


class SwimmingSpeedSettings(BaseModel):
    """Keys of ``[fit.settings]``.

    Attributes
    ----------
    speed, frequency
        Conditions that hold the arm's speed, m/s, and the frequency of the gait, Hz.
    acceleration_m_s2
        Of the arm: what it takes to its speed is left out.
    of
        Which trials: conditions that hold for them.
    by
        Condition whose levels are compared, and what to call them.
    names
        Level -> name.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    speed: str = "v"
    frequency: str = "f"
    acceleration_m_s2: float = Field(default=0.5, gt=0.0)
    of: dict[str, float] = {}
    by: str = "pose"
    names: dict[str, str] = {}


_MEASURED = OutputsAlone((Output("force", "N"),))


@dataclass(frozen=True)
class _Level:
    """Net forces of one level: speed (m/s) and mean force (N) of each trial, shape (n,)."""

    name: str
    speed_m_s: FloatArray
    force_n: FloatArray


class SwimmingSpeedFit:
    """Net force over speed, a parabola for each level, and where it passes zero; intervals by resampling trials."""

    Settings: ClassVar[type[BaseModel]] = SwimmingSpeedSettings

    def __init__(self, settings: SwimmingSpeedSettings) -> None:
        self._settings = settings

    def __call__(self, job: FitJob) -> FitSummary:
        """Fit.

        Raises
        ------
        FitError
            Too few speeds, or a net force that has one sign at all of them.
        """
        data = load_dataset(job.target, _MEASURED, job.signals)
        keys = self._settings
        trials = [one for one in data.trials if all(one.condition.get(k) == v for k, v in keys.of.items())]
        levels = _levels(trials, keys)
        parameters: dict[str, Estimate] = {}
        findings, curves = [], []
        for level in levels:
            found = crossing(level.speed_m_s, level.force_n)
            drawn = [crossing(*_resampled(level, job.rng)) for _ in range(_RESAMPLES)]
            low, high = np.nanpercentile(drawn, [2.5, 97.5])
            parameters[f"speed_{level.name.replace(' ', '_')}"] = Estimate(found, (low, high), "m/s")
            findings.append(f"{level.name}: thrust meets drag at {found:.3f} m/s ({low:.3f} to {high:.3f})")
            line = np.linspace(0.0, 1.1 * max(float(level.speed_m_s.max()), found), 60)
            fitted = np.asarray(
                np.polyval(np.polyfit(level.speed_m_s, level.force_n, 2), line), dtype=np.float64
            )
            curves += [
                Curve(level.speed_m_s, level.force_n, "measured", level.name, kind="points"),
                Curve(line, fitted, "fitted"),
            ]
        findings += _gains(levels, job.rng)
        return FitSummary(
            method="swimming-speed",
            model_name="swimming-speed",
            data=FittedData(
                data.name, data.kind, len(trials), data.left_out + len(data.trials) - len(trials)
            ),
            parameters=parameters,
            findings=tuple(findings),
            figure_data=lambda: _figure(data.name, curves),
        )


def crossing(speed_m_s: FloatArray, force_n: FloatArray) -> float:
    """Return the least speed above 0 at which a parabola through net forces falls through zero.

    Parameters
    ----------
    speed_m_s, force_n : (n,)
        At least three different speeds.

    Returns
    -------
    float
        m/s; NaN if the parabola does not fall through zero below twice the greatest speed.
    """
    square, slope, level = np.polyfit(speed_m_s, force_n, 2)
    roots = np.roots([square, slope, level])
    falls = [
        float(root.real)
        for root in roots
        if abs(root.imag) < 1e-12
        and 0.0 < root.real <= 2.0 * speed_m_s.max()
        and 2 * square * root.real + slope < 0
    ]
    return min(falls, default=float("nan"))


def _levels(trials: Sequence[FitTrial], keys: SwimmingSpeedSettings) -> list[_Level]:
    found: dict[str, list[tuple[float, float]]] = {}
    for trial in trials:
        speed = _number(trial.condition, keys.speed)
        frequency_hz = _number(trial.condition, keys.frequency)
        mean = _whole_cycles(trial, speed / keys.acceleration_m_s2, frequency_hz)
        level = trial.condition.get(keys.by, "")
        name = f"{level:g}" if isinstance(level, int | float) else level
        found.setdefault(keys.names.get(name, name or "gait"), []).append((speed, mean))
    if not found:
        raise FitError("no trial has the conditions of fit.settings.of", hint=f"it asks for {keys.of}")
    levels = []
    for name, pairs in sorted(found.items()):
        speed, force = np.array(sorted(pairs)).T
        if len(set(speed)) < _FEWEST_SPEEDS:
            raise FitError(
                f"{name}: {len(set(speed))} speeds are too few for a parabola",
                hint=f"measure at {_FEWEST_SPEEDS} or more: add values to the axis {keys.speed}",
            )
        if np.isnan(crossing(speed, force)):
            raise FitError(
                f"{name}: the net force, {force.min():.3g} to {force.max():.3g} N, does not fall through zero",
                hint=f"tow slower and faster: {keys.speed} went from {speed.min():g} to {speed.max():g} m/s",
            )
        levels.append(_Level(name, speed, force))
    return levels


def _number(condition: Mapping[str, float | str], name: str) -> float:
    value = condition.get(name)
    if not isinstance(value, int | float):
        raise FitError(
            f"no trial has a number for the condition {name!r}",
            hint=f"conditions are {', '.join(condition)}; fit.settings says which is speed and which frequency",
        )
    return float(value)


def _whole_cycles(trial: FitTrial, ramp_s: float, frequency_hz: float) -> float:
    """Return the mean force over the last whole cycles after the ramp and one cycle, N."""
    time_s = trial.time_s - trial.time_s[0]
    cycles = int((time_s[-1] - max(ramp_s, 1.0 / frequency_hz)) * frequency_hz + 1e-6)
    if cycles < 1:
        raise FitError(
            f"{trial.label}: shorter than two cycles of {frequency_hz:g} Hz", hint="tow farther, or slower"
        )
    return float(trial.outputs[time_s > time_s[-1] - cycles / frequency_hz, 0].mean())


def _gains(levels: Sequence[_Level], rng: np.random.Generator) -> list[str]:
    """Say how much greater the fitted net force of each level is than that of the weakest, at the least speed."""
    at = max(float(one.speed_m_s.min()) for one in levels)
    fitted = {one.name: float(_parabola(one.speed_m_s, one.force_n, at)) for one in levels}
    drawn = {
        one.name: np.array([_parabola(*_resampled(one, rng), at) for _ in range(_RESAMPLES)])
        for one in levels
    }
    weakest = min(fitted, key=lambda name: fitted[name])
    if fitted[weakest] <= 0.0:
        return []
    told = []
    for name, value in fitted.items():
        if name == weakest:
            continue
        low, high = np.percentile(drawn[name] / drawn[weakest], [2.5, 97.5])
        gain, low, high = (100.0 * (ratio - 1.0) for ratio in (value / fitted[weakest], low, high))
        told.append(
            f"at {at:g} m/s {name} has {gain:+.0f} % net force against {weakest} ({low:+.0f} to {high:+.0f} %)"
        )
    return told


def _parabola(speed_m_s: FloatArray, force_n: FloatArray, at_m_s: float) -> float:
    return float(np.polyval(np.polyfit(speed_m_s, force_n, 2), at_m_s))


def _resampled(level: _Level, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw trials anew at each speed."""
    force = level.force_n.copy()
    for speed in set(level.speed_m_s):
        own = np.flatnonzero(level.speed_m_s == speed)
        force[own] = level.force_n[rng.choice(own, len(own))]
    return level.speed_m_s, force


def _figure(name: str, curves: Sequence[Curve]) -> FigureData:
    panel = Panel(tuple(curves), x_label="speed of the arm, m/s", y_label="thrust less drag, N", zero=True)
    return FigureData(f"Thrust less drag of {name}", ((Stack((panel,), width=1.6),),), row_height_in=3.8)
