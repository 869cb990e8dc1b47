"""Trials that run until a condition on their measurements holds, reduced cycle by cycle."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices import Channel, Samples, Trajectory
from labrun.errors import ExperimentError
from labrun.experiment import CYCLES, Criterion, Experiment
from labrun.objectives import make_objective
from labrun.runner.measurement import ObjectiveEvaluation
from labrun.runner.recording import LEAD_S, TAIL_S, TrialRecording
from labrun.runner.rig import Rig
from labrun.signals import Signals
from labrun.store import Journal, RunFolder, dated, tare_of, undated

_HEAD, _CYCLE, _HELD, _REST = "begun", "cycle", "held", "rest"


class CycleLog:
    """The numbers of each cycle, and the samples of some, as they come.

    A killed process loses the cycle it was in. Of a power cut the same holds where the log is durable.

    Parameters
    ----------
    path
        Its file. One that tells of another condition or mounting is set aside under another name.
    about
        What the trial is: condition, mounting and the like, JSON-ready.
    durable
        Whether each line is on disk before the next cycle; a dry run moves nothing.

    Attributes
    ----------
    values : objective -> (cycles,)
        Of all cycles so far.
    head
        Start and tare of the recording; None before it has begun.
    checkpoint
        What the bench was like after the latest stretch, of a dry run.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], *, durable: bool) -> None:
        self._journal = Journal(path, durable=durable)
        self._about = dict(about)
        self.values: dict[str, array[float]] = {}
        self.head: dict[str, Any] | None = None
        self.checkpoint: dict[str, Any] | None = None
        self._kept: list[dict[str, Any]] = []
        events = self._journal.events() if path.exists() else []
        if events and events[0].get("about") != self._about:
            self._set_aside()
            events = []
        if events:
            self._take(events)

    @property
    def cycles(self) -> int:
        """How many there are."""
        return max((len(values) for values in self.values.values()), default=0)

    def begin(self, started_s: float, tare: Mapping[str, float]) -> None:
        """Say when the recording began, and what was found with nothing moving."""
        self.head = {"started_s": started_s, "tare": dict(tare)}
        self._journal.append(_HEAD, about=self._about, **self.head)

    def append(self, values: Mapping[str, float], samples: Mapping[str, Samples]) -> None:
        """Keep a cycle's numbers, and the samples where there are any."""
        more = {
            name: [block.device_time_s, block.host_time_s, block.values] for name, block in samples.items()
        }
        self._journal.append(_CYCLE, values=dict(values), samples=more)
        self._grow(values)

    def hold(self, count: int) -> None:
        """Count unmeasured cycles as equal to the latest one."""
        self._journal.append(_HELD, cycles=count)
        self._repeat(count)

    def rest(self, checkpoint: Mapping[str, Any]) -> None:
        """Keep what the bench is like between two stretches."""
        self._journal.append(_REST, checkpoint=dict(checkpoint))

    def back_to_rest(self) -> None:
        """Drop the cycles since the latest checkpoint; a simulated bench repeats them."""
        events = self._journal.events()
        rests = [number for number, event in enumerate(events) if event["event"] == _REST]
        keep = rests[-1] + 1 if rests else 0
        lines = self._journal.text().splitlines(keepends=True)[:keep]
        self._journal.close()
        self._journal.path.write_text("".join(lines), encoding="utf-8")
        self.values, self.head, self.checkpoint, self._kept = {}, None, None, []
        self._take(events[:keep])

    def kept(self) -> list[tuple[str, Samples]]:
        """Return the samples that were kept by an earlier session, by device, in order; once."""
        results = []
        for event in self._kept:
            for name, (device_s, host_s, values) in event.items():
                rows = np.array(values, dtype=float).reshape(len(device_s), -1)
                results.append((name, Samples(np.array(device_s), np.array(host_s), rows)))
        self._kept = []
        return results

    def remove(self) -> None:
        """Remove the file: the trial is stored."""
        self._journal.close()
        path = self._journal.path
        path.unlink(missing_ok=True)
        with suppress(OSError):  # others may be there
            path.parent.rmdir()

    def close(self) -> None:
        """Release the file."""
        self._journal.close()

    def _take(self, events: Sequence[Mapping[str, Any]]) -> None:
        for event in events:
            if event["event"] == _HEAD:
                self.head = {"started_s": event["started_s"], "tare": event["tare"]}
            elif event["event"] == _CYCLE:
                self._grow(event["values"])
                self._kept.append(event["samples"])
            elif event["event"] == _HELD:
                self._repeat(event["cycles"])
            elif event["event"] == _REST:
                self.checkpoint = event["checkpoint"]

    def _grow(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            self.values.setdefault(name, array("d")).append(value)

    def _repeat(self, count: int) -> None:
        for values in self.values.values():
            values.extend([values[-1]] * count)

    def _set_aside(self) -> None:
        path = self._journal.path
        number = 1
        while (aside := path.with_name(f"{path.stem}-set-aside-{number}{path.suffix}")).exists():
            number += 1
        path.rename(aside)


_TOLD_EVERY = 10
"""Cycles between two words to whoever watches."""


class _Stream:
    """The samples of one device over the cycle that is being measured and the one before."""

    def __init__(self, name: str, channels: tuple[Channel, ...], rate_hz: float) -> None:
        self._head = undated(name, channels, rate_hz)
        self._blocks: list[Samples] = []

    def append(self, block: Samples) -> None:
        self._blocks.append(block)

    def cycle(self, start_s: float, tare: Mapping[str, float]) -> Signals:
        """Return the current cycle with time from its start, and drop earlier ones."""
        self._blocks = [block for block in self._blocks if float(block.host_time_s[-1]) >= start_s - TAIL_S]
        samples = Samples.join(self._blocks, len(self._head.columns))
        return replace(dated(self._head, samples, start_s), tare=tare_of(self._head.name, tare))


class UntilRecorder:
    """Records cycle after cycle until the condition of ``[trial.until]`` holds, or there are as many as allowed.

    The motion goes out in stretches of `keep_every` cycles; between two of them the joints rest for a moment. Each
    cycle is reduced to its objectives, which are on disk before the next one ends; of the first cycle of each stretch
    the samples are kept as well, dated by the motion: rests are taken out. An interrupted trial goes on with the cycle
    after the last one that was kept.

    With `judge_every`, stretches are as long as that, once the first `keep_every` cycles are over, and the first cycle
    of each is measured. A dry run computes nothing of the sensors in the others.

    Parameters
    ----------
    seed
        Of device noise; each stretch has its own.
    phase
        Told how far it is.
    """

    def __init__(
        self,
        experiment: Experiment,
        rig: Rig,
        folder: RunFolder,
        *,
        seed: int,
        phase: Callable[[str], object],
    ) -> None:
        until = experiment.trial.until
        assert until is not None  # noqa: S101  (asked by the caller)
        self._until = until
        self._rig = rig
        self._folder = folder
        self._seed = seed
        self._phase = phase
        self._tables = {
            name: objective for name, objective in experiment.objectives.items() if objective.plugin != CYCLES
        }
        self._counts = [name for name in experiment.objectives if name not in self._tables]
        self._criterion = Criterion.of(until.when, list(self._tables))
        self._evaluation = ObjectiveEvaluation(experiment.model_copy(update={"objectives": self._tables}))

    def __call__(self, recording: TrialRecording) -> None:
        """Record one trial, or the rest of it."""
        motion, request = recording.motion, recording.request
        if motion.period_s is None:
            raise ExperimentError("trial.until needs a gait that repeats, and this one has no period")
        about = {"condition": dict(request.condition), "role": request.role, "mounting": request.mounting}
        path = self._folder.path / CYCLES / f"{request.index:06d}.jsonl"
        path.parent.mkdir(exist_ok=True)
        log = CycleLog(path, about, durable=not self._rig.dry_run)
        try:
            self._take_up(recording, log)
            ended = self._record(recording, log, motion.period_s)
        finally:
            log.close()
        self._conclude(recording, log, motion.period_s, ended=ended)

    def _take_up(self, recording: TrialRecording, log: CycleLog) -> None:
        """Begin, or go on with what the log holds."""
        bench, request = recording.bench, recording.request
        if self._rig.dry_run and log.head is not None:
            log.back_to_rest()  # what came after is simulated once more, to the same numbers
        if self._rig.dry_run and log.checkpoint is not None and log.head is not None:
            bench.stop_sensors()
            bench.restore(log.checkpoint)
            self._rig.reseed(self._seed, request.index, log.cycles)
            bench.start_sensors()
            recording.tare = log.head["tare"]
        if log.head is None:
            log.begin(bench.clock.now() + LEAD_S, recording.tare)
        assert log.head is not None  # noqa: S101  (just begun, if it had not)
        recording.begin(log.head["started_s"])
        for name, samples in log.kept():
            sensor = self._rig.sensors[name]
            recording.collector.writer.append(name, sensor.channels, sensor.rate_hz, samples)

    def _record(self, recording: TrialRecording, log: CycleLog, period_s: float) -> bool:
        """Run stretch after stretch; return whether the condition held in the end."""
        bench, until = recording.bench, self._until
        if log.cycles and self._criterion.holds(log.values):
            return True  # stopped between the last cycle and its storing
        while log.cycles < until.max_cycles:
            sparing = until.judge_every > 1 and log.cycles >= until.keep_every
            slot = log.cycles % until.keep_every
            count = min(until.keep_every - slot, until.max_cycles - log.cycles)
            if sparing:
                count = min(count, until.judge_every - slot % until.judge_every)
            start_s = bench.clock.now() + LEAD_S
            bench.follow(_beginning(recording.motion.trajectory, count * period_s), start_s)
            if self._stretch(recording, log, start_s, period_s, 1 if sparing else count):
                return True
            if sparing and count > 1:
                self._pass_over(recording, start_s + count * period_s + TAIL_S)
                log.hold(count - 1)
            if self._rig.dry_run and log.cycles < until.max_cycles and log.cycles % until.keep_every == 0:
                bench.stop_sensors()
                log.rest(bench.snapshot())
                self._rig.reseed(self._seed, recording.request.index, log.cycles)
                bench.start_sensors()
        return False

    def _stretch(
        self, recording: TrialRecording, log: CycleLog, start_s: float, period_s: float, count: int
    ) -> bool:
        """Measure cycles of a running motion; return whether the condition holds."""
        bench, collector = recording.bench, recording.collector
        streams = {
            name: _Stream(name, sensor.channels, sensor.rate_hz) for name, sensor in self._rig.sensors.items()
        }

        def take(blocks: Mapping[str, Samples]) -> None:
            for name, block in blocks.items():
                collector.count(name, block)
                if len(block):
                    streams[name].append(block)

        course = _beginning(recording.motion.trajectory, period_s)
        motion = replace(recording.motion, trajectory=course, duration_s=period_s, cycles=1)
        for number in range(count):
            begun_s = start_s + number * period_s
            bench.watch(begun_s + period_s + TAIL_S, take)
            signals = {name: stream.cycle(begun_s, recording.tare) for name, stream in streams.items()}
            values = self._evaluation.evaluate(signals, motion, recording.condition)
            kept = self._kept(recording, log, signals, begun_s, period_s)
            log.append(values, kept)
            if log.cycles % _TOLD_EVERY == 0:
                self._phase(f"cycle {log.cycles} of at most {self._until.max_cycles}")
            if self._criterion.holds(log.values):
                first = recording.motion.trajectory
                rest = dict(zip(first.joints, first.angle_rad[0], strict=True))
                bench.move(rest, recording.move_speed_rad_s)
                return True
        return False

    def _pass_over(self, recording: TrialRecording, until_s: float) -> None:
        """Let the joints move on without measuring; on a bench its health is looked at all the same."""
        bench, collector = recording.bench, recording.collector

        def take(blocks: Mapping[str, Samples]) -> None:
            for name, block in blocks.items():
                collector.count(name, block)

        if not self._rig.dry_run:
            bench.watch(until_s, take)
            return
        bench.stop_sensors()
        bench.clock.sleep(until_s - bench.clock.now())
        bench.start_sensors()

    def _kept(
        self,
        recording: TrialRecording,
        log: CycleLog,
        signals: Mapping[str, Signals],
        begun_s: float,
        period_s: float,
    ) -> dict[str, Samples]:
        """Hand the samples of every so many cycles to the trial's file, and return them for the log."""
        if log.cycles % self._until.keep_every or log.head is None:
            return {}
        kept = {}
        moved_s = log.head["started_s"] + log.cycles * period_s - begun_s
        for name, signal in signals.items():
            inside = signal.between(0.0, np.nextafter(period_s, 0.0))
            if inside.device_time_s is None or inside.host_time_s is None or not len(inside):
                continue
            kept[name] = Samples(inside.device_time_s + moved_s, inside.host_time_s + moved_s, inside.values)
            recording.collector.writer.append(
                name, self._rig.sensors[name].channels, self._rig.sensors[name].rate_hz, kept[name]
            )
        return kept

    def _conclude(self, recording: TrialRecording, log: CycleLog, period_s: float, *, ended: bool) -> None:
        assert log.head is not None  # noqa: S101  (it has begun)
        time_s = log.head["started_s"] + period_s * np.arange(1, log.cycles + 1)
        channels = tuple(Channel(name, self._unit(name)) for name in log.values)
        table = np.column_stack([np.asarray(values) for values in log.values.values()])
        recording.collector.writer.append(CYCLES, channels, 1.0 / period_s, Samples(time_s, time_s, table))
        means = {name: float(np.mean(values)) for name, values in log.values.items()}
        recording.objectives = means | dict.fromkeys(self._counts, float(log.cycles))
        recording.duration_s = log.cycles * period_s
        recording.censored = not ended
        recording.stored = log.remove

    def _unit(self, objective: str) -> str:
        table = self._tables[objective]
        device, _, channel = (table.channel or "").partition(".")
        sensor = self._rig.sensors.get(device)
        units = {item.name: item.unit for item in sensor.channels} if sensor is not None else {}
        return make_objective(objective, table).unit(units.get(channel, ""))


def _beginning(motion: Trajectory, duration_s: float) -> Trajectory:
    """Return the first so many seconds of a motion."""
    if duration_s >= motion.duration_s * (1 - 1e-12):
        return motion
    times = motion.time_s[motion.time_s < duration_s * (1 - 1e-12)]
    times = np.append(times, duration_s)
    return Trajectory(motion.joints, times, motion.at(times), motion.period_s)
