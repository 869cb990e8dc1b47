"""What the releases of a hinge tell beyond their means: scatter, air drag, dry friction, the body's uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.devices import FloatArray
from labrun.fit import Estimate, FitTrial, TextTable, rounded, student
from labrun_plugins.rigs.hinge.body import FOUND, Body
from labrun_plugins.rigs.hinge.releases import Release

_CLOSE = 5e-3
_ABOVE_NOISE = 2.0
"""A residual this many times the sensor's noise is not noise: the model lacks something."""
_FEWEST_FOR_A_TREND = 5
_AMPLITUDES_APART = 1.3
_SURE = 0.995
"""Quantile of Student's t that a trend has to exceed: one in a hundred data sets without one shows one."""
_LEAST_TREND = 0.02
_NORMAL = 1.96


@dataclass(frozen=True, slots=True)
class Trend:
    """A straight line of one quantity over the release's amplitude.

    Attributes
    ----------
    at_rest : Estimate
        Where the line meets amplitude zero.
    small, large
        The quantity at the smallest and at the largest amplitude.
    growth, growth_half_width
        From there to there, relative to the value at the smallest, with half of its 95 % interval.
    sure
        Whether there is a trend at all.
    residual : (T,)
        What is left of every release's value.
    """

    at_rest: Estimate
    small: float
    large: float
    growth: float
    growth_half_width: float
    sure: bool
    residual: FloatArray


def trend(amplitude: FloatArray, values: FloatArray, unit: str) -> Trend | None:
    """Return the line of least squares; None for too few releases, or where all are alike in amplitude."""
    count = len(values)
    low, high = float(np.min(amplitude)), float(np.max(amplitude))
    if count < _FEWEST_FOR_A_TREND or high < _AMPLITUDES_APART * low:
        return None
    matrix = np.column_stack([np.ones(count), amplitude])
    line = np.linalg.lstsq(matrix, values, rcond=None)[0]
    residual = values - matrix @ line
    covariance = np.linalg.inv(matrix.T @ matrix) * float(residual @ residual) / (count - 2)
    at_rest, per_rad = float(line[0]), float(line[1])
    half_at_rest, half_slope = student(count - 2) * np.sqrt(np.diag(covariance))
    small, large = at_rest + per_rad * low, at_rest + per_rad * high
    size = max(abs(small), 1e-300)
    growth = per_rad * (high - low) / size
    error = float(np.sqrt(covariance[1, 1]))
    sure = abs(per_rad) > student(count - 2, _SURE) * error and abs(growth) > _LEAST_TREND
    return Trend(
        Estimate(at_rest, (at_rest - float(half_at_rest), at_rest + float(half_at_rest)), unit),
        small,
        large,
        growth,
        float(half_slope) * (high - low) / size,
        bool(sure),
        residual,
    )


def by_test(
    trials: Sequence[FitTrial], releases: Sequence[Release], units: Sequence[str]
) -> tuple[TextTable, ...]:
    """Return stiffness and damping of every test with mean and scatter, as Table 3.2; none without two tests.

    A test is what the conditions call ``test``; its values are means over its releases.
    """
    tests: dict[float | str, list[FloatArray]] = {}
    for trial, release in zip(trials, releases, strict=True):
        if "test" in trial.condition:
            tests.setdefault(trial.condition["test"], []).append(release.values)
    if len(tests) < 2:
        return ()
    values = np.array([np.mean(tests[name], axis=0) for name in sorted(tests, key=str)])
    mean, sd = values.mean(axis=0), values.std(axis=0, ddof=1)
    rows = [
        (f"{name:g}" if isinstance(name, float | int) else name, *(f"{value:.4g}" for value in row))
        for name, row in zip(sorted(tests, key=str), values, strict=True)
    ]
    rows += [
        ("mean", *(f"{value:.4g}" for value in mean)),
        ("standard deviation", *(f"{value:.2g}" for value in sd)),
        ("of the mean", *(f"{100 * share:.2g} %" for share in sd / np.abs(mean))),
    ]
    header = ("test", *(f"{name}, {unit}" for name, unit in zip(FOUND, units, strict=True)))
    return (TextTable(f"between {len(tests)} tests", header, tuple(rows)),)


def release_findings(releases: Sequence[Release], units: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return findings, and warnings, on how stiffness and damping differ from release to release."""
    values = np.array([release.values for release in releases])
    sigma = np.array([release.sigma for release in releases])
    amplitude = np.array([release.amplitude_rad for release in releases])
    small_deg, large_deg = np.degrees([np.min(amplitude), np.max(amplitude)])
    spreads, warnings = [], []
    for column, (name, unit) in enumerate(zip(FOUND, units, strict=True)):
        line = trend(amplitude, values[:, column], unit)
        about = values[:, column] - values[:, column].mean()
        freedom = len(values) - 1
        if line is not None and line.sure:
            warnings.append(_told(name, line, float(small_deg), float(large_deg)))
            about, freedom = line.residual, freedom - 1
        # what the residual of each release leaves open is no scatter of the hinge
        variance = float(about @ about) / freedom - float(np.mean(sigma[:, column] ** 2))
        size = abs(float(values[:, column].mean()))
        if variance > 0 and size > 0:
            spreads.append(f"{name} varies by {100 * np.sqrt(variance) / size:.2g} %")
    findings = [f"between releases {' and '.join(spreads)} (standard deviation)"] if spreads else []
    return findings, warnings


def _told(name: str, line: Trend, small_deg: float, large_deg: float) -> str:
    way = "grows" if line.growth * line.small > 0 else "falls"
    cause = {
        ("damping", "grows"): "air drag does that, which eq. (3.5) lacks",
        ("damping", "falls"): "dry friction does that, which eq. (3.5) lacks",
    }.get((name, way), "the spring is not linear, or the angle's zero is not where the hinge is flat")
    value, low, high = rounded(line.at_rest)
    sure = f"95 % interval \N{PLUS-MINUS SIGN}{100 * line.growth_half_width:.1g} %"
    return (
        f"{name} {way} from {line.small:.3g} to {line.large:.3g} {line.at_rest.unit} between releases from "
        f"{small_deg:.0f} and from {large_deg:.0f} deg "
        f"({100 * line.growth:+.0f} %, {sure}): {cause}; "
        f"extrapolated to small swings it is {value} ({low} ... {high}) {line.at_rest.unit}"
    )


def body_warning(body: Body, stiffness: float) -> list[str]:
    """Say what the uncertainty of the stated body means: it shifts all releases, and both ways, alike.

    The frequency gives ``(k + m g r) / I``, the decay ``b / I``, for small swings.
    """
    if body.gravity_torque is None or (body.inertia_tolerance == 0 and body.gravity_tolerance == 0):
        return []
    by_inertia = body.inertia_tolerance * abs(stiffness + body.gravity_torque)
    by_gravity = body.gravity_tolerance * abs(body.gravity_torque)
    stiffness_share = _NORMAL * float(np.hypot(by_inertia, by_gravity)) / max(abs(stiffness), 1e-300)
    damping_share = _NORMAL * body.inertia_tolerance
    return [
        f"the body is taken as stated: inertia to {100 * body.inertia_tolerance:.2g} %, gravity_torque to "
        f"{100 * body.gravity_tolerance:.2g} %. That shifts both ways alike and is not in the intervals: "
        f"stiffness by up to {100 * stiffness_share:.2g} %, damping by up to {100 * damping_share:.2g} % (95 %)"
    ]


def agreement_warnings(found: dict[str, Estimate], fourier: dict[str, Estimate]) -> list[str]:
    """Return what both ways do not agree on."""
    return [
        f"the two ways disagree on {name}: {_text(found[name])} by simulation, {_text(estimate)} by Fourier "
        "derivatives; on a swing that follows eq. (3.5) they agree"
        for name, estimate in fourier.items()
        if name in found and _apart(found[name], estimate)
    ]


def residual_warning(rmse: float, noise: float) -> list[str]:
    """Say that eq. (3.5) leaves more than the sensor's noise, which is what a Fourier series leaves."""
    if rmse <= _ABOVE_NOISE * noise:
        return []
    return [
        f"eq. (3.5) leaves {1e3 * rmse:.2g} mrad where a Fourier series of each swing leaves "
        f"{1e3 * noise:.2g} mrad: the swing has forces that it lacks, such as dry friction or air drag, "
        "and they bias its parameters"
    ]


def _apart(one: Estimate, other: Estimate) -> bool:
    """Tell whether two intervals do not meet, and the values differ by more than numbers do."""
    close = abs(one.value - other.value) <= _CLOSE * max(abs(one.value), abs(other.value))
    return not close and (one.ci95[1] < other.ci95[0] or other.ci95[1] < one.ci95[0])


def _text(estimate: Estimate) -> str:
    value, low, high = rounded(estimate)
    return f"{value} ({low} ... {high})"
