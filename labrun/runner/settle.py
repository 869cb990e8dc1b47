"""Before a recording: wait until the bench is at rest."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.devices import Samples
from labrun.errors import ExperimentError, SettleError, SpecError
from labrun.experiment import Settle
from labrun.runner.bench import Bench
from labrun.runner.rig import Rig
from labrun.runner.stillness import BaselineMeter, Bounds, SettleDetector, Watched
from labrun.signals import Signals
from labrun.store import SettleSummary, TrialOutcome, settle_curve

_BASELINE_HOLDS = 6.0
_BASELINE_S = 10.0
_LOOKS_PER_HOLD = 2.0
"""At least so often, however coarse the clock: the end of settling is not to wait for the next look."""


@dataclass(frozen=True, slots=True)
class Settled:
    """How settling ended.

    Attributes
    ----------
    summary, curve
        What is stored with the trial; the curve is None where nothing was watched.
    rejected
        Why the trial must not go on; empty if it may.
    """

    summary: SettleSummary | None
    curve: Signals | None
    rejected: str = ""


def watched_channels(rule: Settle, rig: Rig) -> tuple[Watched, ...]:
    """Return the channels a settle rule looks at: the one it names, else every force, else every torque, else all."""
    known = [
        Watched(name, column, f"{name}.{channel.name}", channel.unit)
        for name, sensor in rig.sensors.items()
        for column, channel in enumerate(sensor.channels)
    ]
    if rule.channel is not None:
        chosen = tuple(item for item in known if item.name == rule.channel)
        if not chosen:
            names = ", ".join(item.name for item in known) or "none: the rig has no sensor"
            raise SpecError(
                f"trial.settle.channel: it has no channel {rule.channel!r}", hint=f"channels: {names}"
            )
        return chosen
    if not known:
        raise SpecError(
            "trial.settle needs a sensor to watch, and the rig has none", hint='use until = "time"'
        )
    for unit in ("N", "N m"):
        chosen = tuple(item for item in known if item.unit == unit)
        if chosen:
            return chosen
    return tuple(known)


def needs_baseline(rule: Settle | None) -> bool:
    """Tell whether the rule compares with the bench's own quiet baseline."""
    return rule is not None and rule.until == "quiet" and rule.below is None


def measure_baseline(bench: Bench, rule: Settle) -> Bounds:
    """Measure how still the undisturbed bench is. Raises ExperimentError: too few samples came in to judge."""
    watched = watched_channels(rule, bench.rig)
    meter = BaselineMeter(watched, rule.hold_s)
    bench.start_sensors()
    duration_s = max(_BASELINE_S, _BASELINE_HOLDS * rule.hold_s)
    bench.watch(bench.clock.now() + duration_s, lambda blocks: meter.feed(blocks, bench.clock.now()))
    bench.stop_sensors()
    bounds = meter.bounds()
    if bounds is None:
        raise ExperimentError(_too_few(watched, rule), hint="raise trial.settle.hold_s")
    return bounds


def settle(bench: Bench, rule: Settle | None, baseline: Bounds | None) -> Settled:
    """Wait until the bench is at rest; sensors must be running, and are under watch meanwhile.

    Raises SettleError: not at rest in time, and the file says ``on_timeout = "stop"``.
    """
    if rule is None:
        return Settled(None, None)
    start_s = bench.clock.now()
    if rule.until == "time":
        bench.watch(start_s + rule.hold_s)
        return Settled(SettleSummary("time", bench.clock.now() - start_s), None)
    watched = watched_channels(rule, bench.rig)
    bounds = _bounds(rule, baseline, len(watched))
    detector = SettleDetector(watched, bounds, rule.hold_s, start_s)
    deadline_s = start_s + rule.timeout_s
    while not detector.settled and bench.clock.now() < deadline_s:
        _look(bench, detector, deadline_s)
    reason = "quiet" if detector.settled else "timeout"
    return _ended(rule, detector, bounds, reason, bench.clock.now() - start_s)


def _look(bench: Bench, detector: SettleDetector, deadline_s: float) -> None:
    # Before the first hold time has passed there is nothing to judge; after it, looks are finer than a coarse clock's.
    first_s = detector.start_s + detector.hold_s - bench.clock.now()
    step_s = min(bench.clock.poll_s, max(first_s, detector.hold_s / _LOOKS_PER_HOLD))
    bench.clock.sleep(min(step_s, deadline_s - bench.clock.now()))
    blocks: Mapping[str, Samples] = bench.look()
    detector.feed(blocks, bench.clock.now())


def _bounds(rule: Settle, baseline: Bounds | None, channels: int) -> Bounds:
    if rule.below is not None:
        return Bounds((rule.below,) * channels, (rule.below,) * channels)
    if baseline is None:
        raise ExperimentError("the quiet baseline of the bench was not measured before the first trial")
    return Bounds(
        tuple(rule.factor * value for value in baseline.spread),
        tuple(rule.factor * value for value in baseline.drift),
    )


def _ended(rule: Settle, detector: SettleDetector, bounds: Bounds, reason: str, duration_s: float) -> Settled:
    channel = detector.watched[detector.worst]
    bound = bounds.spread[detector.worst]
    spread = detector.spread[-1] if detector.spread else None
    drift = detector.drift[-1] if detector.drift else None
    summary = SettleSummary(reason, duration_s, spread, drift, bound, channel.name)
    curve = settle_curve(
        np.array(detector.time_s), np.array(detector.spread), np.array(detector.drift), channel.unit
    )
    if reason == "quiet" or rule.on_timeout == "go-on":
        return Settled(summary, curve)
    if spread is None or drift is None:
        text = _too_few(detector.watched, rule)
    else:
        text = (
            f"not at rest after {duration_s:.0f} s: {channel.name} spreads by {spread:.3g} and drifts by {drift:.3g} "
            f"{channel.unit} in {rule.hold_s:g} s, {bound:.3g} {channel.unit} is allowed"
        )
    if rule.on_timeout == "stop":
        raise SettleError(
            text, hint="look for what disturbs the bench, or raise trial.settle.timeout_s or below"
        )
    return Settled(summary, curve, rejected=text)


def _too_few(watched: tuple[Watched, ...], rule: Settle) -> str:
    names = ", ".join(item.name for item in watched)
    return f"{names} gave too few samples in {rule.hold_s:g} s to tell motion from noise"


def unsettled(outcome: TrialOutcome) -> bool:
    """Tell whether a trial counts although the bench had not come to rest before it."""
    return outcome.status == "done" and outcome.settle is not None and outcome.settle.reason == "timeout"


def settle_estimate_s(rule: Settle | None) -> float:
    """Return the settle time a plan counts with: two hold times, the least that evidence takes; never above the cap."""
    if rule is None:
        return 0.0
    if rule.until == "time":
        return rule.hold_s
    return min(2.0 * rule.hold_s, rule.timeout_s)
