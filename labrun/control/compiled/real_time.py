"""A compiled loop on a bench: a thread without interpreter looks, computes and sends; Python keeps its record.

The thread shares memory with Python: sensors' newest samples on one side, a ring of records on the other. What Python
does meanwhile, and how long it holds its lock, moves no step.
"""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.control.compiled.law import refusal
from labrun.control.compiled.stepping import FULL, GOOD, STOPPED, UNSENT, UNWATCHED, Law, take_step
from labrun.devices.compiled import FREE_S, HALT, NOT_TAKEN, SENT, CompiledWire, HandingOver, Showing
from labrun.devices.listening import SLOTS, Bell, Newest
from labrun.devices.system_calls import clock_s, sleep_until_rung, wait_until
from labrun.models.engine import call_model
from labrun.runner import Rig

HEAD, TAIL, STOP, SKIPPED, WATCHED_NS = range(5)
"""Places of what both sides share: records written, records read, whether to stop, steps skipped at the end, when the
runner last looked at the bench (monotonic clock, ns)."""
UNWATCHED_S = 0.1
"""For how long the loop goes on while the runner does not look: it alone checks what no step sees (forces, sensors that
fell silent, Ctrl-C). It looks every 0.02 s."""
MORE = 6
"""Numbers of a record before those of `take_step`: begin of the step (trial time); time from when the newest sample was
made, and, if it was not seen before, from when it was received, to when the command was sent; how late the step
began (s); whether its command came too late or not at all; steps skipped before."""
_RING_S = 2.0
_SPIN_S = 1.5e-4
"""Waking up takes the system some 0.05 to 0.1 ms."""
_LEAST_SHARE = 0.25
"""Of a period, between two steps: a rate of change over less would be that of the noise."""
_AHEAD = 12
"""Steps that a loop may be ahead of its rate. Where samples come as often as steps, each step is then taken for a
sample, though one comes late now and then and the next ones all at once; with a step or two, those would wait."""
_FAR_AHEAD = 8
"""Steps ahead of its rate from which on none is made up for: at `_AHEAD` samples would wait after all."""
_MADE_UP_SHARE = 0.4
"""Of a period after the step before: when a step is made up for that a sample had lost to a newer one. What it acts on
is still young then; when it is due it would be a period old, or more."""
_YOUNG_SHARE = 0.8
"""Of a period after the newest sample came: until when a step is made up for. Later ones wait for the next sample."""
_PRIORITY, _PRIORITY_OF_PYTHON = 50, 10
_SWITCH_S = 2e-4
"""Python's own 5 ms are what a thread that hears a sensor may wait for one that stores or draws."""


class LiveBench(NamedTuple):
    """What a loop reads and writes, as compiled code sees it.

    Attributes
    ----------
    number, made_s, heard_s, values : (sensors, ...)
        See `labrun.devices.listening.NewestView`; of all sensors.
    channels_at : (sensors + 1,)
        Where each one's channels begin among all channels.
    bell
        Descriptor of the `labrun.devices.listening.Bell` that the sensors of the feedback ring.
    send, state, parameters
        See `labrun.devices.compiled.CompiledWire`.
    """

    number: tuple[IntArray, ...]
    made_s: tuple[FloatArray, ...]
    heard_s: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]
    channels_at: IntArray
    bell: int
    send: int
    state: FloatArray
    parameters: FloatArray


@kernel
def run_steps(
    law: Law, bench: LiveBench, references: FloatArray, start_s: float, period_s: float, steps: int,
    drives: FloatArray, angles: FloatArray, ring: FloatArray, shared: IntArray,
) -> int:  # fmt: skip
    """Take all steps of a trial; return `GOOD` or why it ended before.

    A step is taken when it is due, or up to `_AHEAD` periods sooner: when a sample comes that no step has seen, the
    wire has room, and a quarter of a period has passed since the step before. Its reference is that of the time when
    it is taken. Of samples that came at once the newest counts, and the steps of the others are made up for soon after
    its own. A step that is late is taken as soon as can be; those that fell due meanwhile are skipped and counted.
    """
    joints = len(angles)
    latest = np.full(bench.channels_at[-1], np.nan)
    latest_s = np.full(len(bench.number), -np.inf)
    seen, fresh = np.zeros(len(bench.number), dtype=np.int64), np.zeros(len(bench.number), dtype=np.bool_)
    nothing, said = np.zeros(1), np.zeros(1)
    unlearned, one = np.empty_like(latest), law.wiring.sensor[0]
    queue = np.zeros(2 + SLOTS, dtype=np.int64)
    learns = (law.wiring.sensor == one).all()
    number, owed, before_s, newest_s = 0, 0, start_s - period_s, -np.inf
    while number < steps:
        young_s = newest_s + _YOUNG_SHARE * period_s if owed > 0 else -np.inf
        now_s = await_step(law, bench, seen, start_s, period_s, number, before_s, young_s)
        if shared[STOP] != 0:
            return STOPPED
        if now_s - 1e-9 * shared[WATCHED_NS] > UNWATCHED_S:
            return UNWATCHED
        newest = max(0, int((now_s - start_s) / period_s + 1e-9))
        skipped = max(0, min(newest, steps) - number)
        number += skipped
        if number >= steps:
            shared[SKIPPED] += skipped
            break
        if shared[HEAD] - shared[TAIL] >= len(ring):
            return FULL
        made_s, heard_s = np.inf, np.inf
        begun = before_s >= start_s  # what came before the first step asks for none
        owed = min(max(owed + _passed_over(law, bench, seen), 0), _AHEAD) if begun else 0
        before = seen[one]
        for sensor in range(len(bench.number)):
            fresh[sensor] = _look(bench, sensor, start_s, latest, latest_s, seen)
        for sensor in law.wiring.sensor:
            made_s = min(made_s, latest_s[sensor])
            if fresh[sensor]:
                heard_s = min(heard_s, bench.heard_s[sensor][(seen[sensor] - 1) % SLOTS])
        unlearned_s = -np.inf
        if begun and learns:
            unlearned_s = _unlearned(bench, one, before, seen[one], start_s, latest, queue, unlearned)
        newest_s = heard_s if np.isfinite(heard_s) else newest_s
        record = ring[shared[HEAD] % len(ring)]
        status = take_step(
            law, now_s - start_s, now_s - before_s, references[newest], latest, latest_s, unlearned, unlearned_s,
            drives, angles, record[MORE + joints :],
        )  # fmt: skip
        if status != GOOD:
            return status
        before_s = now_s
        call_model(bench.send, clock_s(), bench.state, angles, bench.parameters, nothing, said)
        if said[0] != SENT and said[0] != NOT_TAKEN:
            return UNSENT + int(said[0])
        sent_s = clock_s()
        due_s = start_s + number * period_s
        number += 1
        record[0], record[1] = now_s - start_s, sent_s - start_s - made_s
        record[2], record[3] = sent_s - heard_s if np.isfinite(heard_s) else np.nan, max(0.0, now_s - due_s)
        missed = said[0] != SENT or sent_s > start_s + (number + 1e-9) * period_s
        record[4], record[5] = 1.0 if missed else 0.0, skipped
        for j in range(joints):
            record[MORE + j] = angles[j]
        clock_s()  # a call to the system: the record is in memory before its number
        shared[HEAD] += 1
    return GOOD


@kernel
def await_step(
    law: Law, bench: LiveBench, seen: IntArray, start_s: float, period_s: float, number: int, before_s: float,
    made_up_until_s: float,
) -> float:  # fmt: skip
    """Wait until a step is to be taken, see `run_steps`; return the time.

    The one before began at `before_s`; until `made_up_until_s` a step may be made up for, -inf if none is owed.
    """
    due_s = start_s + number * period_s
    if number == 0:
        return float(wait_until(due_s, _SPIN_S))
    ahead_s = _AHEAD * period_s
    soonest_s = max(due_s - ahead_s, before_s + _LEAST_SHARE * period_s, bench.state[FREE_S])
    made_up_s = max(before_s + _MADE_UP_SHARE * period_s, due_s - _FAR_AHEAD * period_s, soonest_s)
    if made_up_s <= made_up_until_s:
        due_s = min(due_s, made_up_s)
    now_s = wait_until(min(due_s, soonest_s), 0.0)
    while now_s < due_s and not _fresh(law, bench, seen):
        long = due_s - now_s > _SPIN_S
        now_s = sleep_until_rung(bench.bell, due_s - _SPIN_S) if long else clock_s()
    return float(now_s)


@kernel
def _fresh(law: Law, bench: LiveBench, seen: IntArray) -> bool:
    """Tell whether a sensor of the feedback has a sample that no step has seen."""
    fresh = False
    for sensor in law.wiring.sensor:
        fresh = fresh or bench.number[sensor][0] > seen[sensor]
    return fresh


@kernel
def _passed_over(law: Law, bench: LiveBench, seen: IntArray) -> int:
    """Return how many samples get no step of their own, because a newer one is there; -1 if there is no new one.

    Of several sensors, of that which has the fewest.
    """
    fewest = _AHEAD
    for sensor in law.wiring.sensor:
        fewest = min(fewest, bench.number[sensor][0] - seen[sensor] - 1)
    return int(fewest)


@kernel
def _look(
    bench: LiveBench, sensor: int, start_s: float, latest: FloatArray, latest_s: FloatArray, seen: IntArray
) -> bool:
    """Take over a sensor's newest sample; tell whether it was not seen before."""
    count = bench.number[sensor][0]
    fresh = count > seen[sensor]
    if fresh:
        seen[sensor] = count
        row, begin = (count - 1) % SLOTS, bench.channels_at[sensor]
        latest_s[sensor] = bench.made_s[sensor][row] - start_s
        for column in range(bench.values[sensor].shape[1]):
            latest[begin + column] = bench.values[sensor][row, column]
    return bool(fresh)


@kernel
def _unlearned(
    bench: LiveBench, sensor: int, before: int, now: int, start_s: float, latest: FloatArray, queue: IntArray,
    row: FloatArray,
) -> float:  # fmt: skip
    """Find a sample to learn from that had no step of its own.

    Parameters
    ----------
    sensor, before, now
        Of the feedback; numbers of its samples that the step before and this one see.
    queue : (2 + SLOTS,)
        How many have been taken from it, and put into it; numbers of samples that no step has learned from.
    row : (channels,)
        Gets the latest of all channels, but that sample of its sensor.

    Returns
    -------
    float
        When the sample was made, trial time; -inf if there is none, or this step has a new one to learn from.
    """
    for number in range(max(before, now - _AHEAD) + 1, now):
        queue[2 + queue[1] % SLOTS] = number
        queue[1] += 1
    while queue[0] < queue[1] and now - queue[2 + queue[0] % SLOTS] > _AHEAD:
        queue[0] += 1  # its place may be another's soon
    if queue[0] == queue[1] or now > before:
        return -np.inf
    place, begin = (queue[2 + queue[0] % SLOTS] - 1) % SLOTS, bench.channels_at[sensor]
    queue[0] += 1
    row[:] = latest
    for column in range(bench.values[sensor].shape[1]):
        row[begin + column] = bench.values[sensor][place, column]
    return float(bench.made_s[sensor][place] - start_s)


@dataclass
class RealTimeLoop:
    """The thread of one trial, and what it shares with Python.

    Parameters
    ----------
    rig
        Whose sensors show, and whose actuator hands over.
    law, references
        The loop, and its reference at every step, (steps, components).
    joints
        That it moves, in the order of its gait.
    angles : (joints,)
        Where the joints were told to be, rad.

    Attributes
    ----------
    status
        `GOOD`, or why it ended before its time; `None` while it runs.
    """

    rig: Rig
    law: Law
    references: FloatArray
    joints: tuple[str, ...]
    drives: FloatArray
    angles: FloatArray
    period_s: float
    status: int | None = None
    _shared: IntArray = field(default_factory=lambda: np.zeros(5, dtype=np.int64))
    _failure: BaseException | None = None
    _thread: threading.Thread | None = None
    _wire: CompiledWire | None = None
    _switch_s: float = 5e-3
    _hurried: Sequence[int] = ()

    def __post_init__(self) -> None:
        self._device = require_real_time(self.rig, self.joints)
        rows = max(64, round(_RING_S / self.period_s))
        width = MORE + len(self.joints) + 3 * len(self.law.wiring.channel) + 2 * len(self.drives) + 5
        self._ring = np.empty((rows, width))
        self._bell = Bell()
        self._shown = {
            name: Newest(len(one.channels), self._bell if number in self.law.wiring.sensor else None)
            for number, (name, one) in enumerate(self.rig.sensors.items())
        }

    def show(self) -> None:
        """Let the sensors show their samples from now on."""
        for name, newest in self._shown.items():
            cast("Showing", self.rig.sensors[name]).show(newest)

    def seen(self) -> bool:
        """Tell whether every sensor has shown one."""
        return all(newest.view.number[0] > 0 for newest in self._shown.values())

    def begin(self, start_s: float) -> None:
        """Take the actuator over, and begin when the clock shows `start_s`."""
        wire = self._wire = self._device.hand_over(self.joints, self.angles.copy(), 1.0 / self.period_s)
        widths = [one.view.values.shape[1] for one in self._shown.values()]
        bench = self._bench(np.cumsum([0, *widths]), wire.send, wire.state, wire.parameters)
        self._shared[WATCHED_NS] = time.monotonic_ns()
        arguments = (self.law, bench, self.references, start_s, self.period_s)
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_S)
        self._hurried = _hurry()
        self._thread = threading.Thread(
            target=self._run, args=(*arguments, len(self.references)), daemon=True, name="compiled loop"
        )
        self._thread.start()

    def compile(self) -> None:
        """Have it compiled, with no step taken: seconds the first time, in which nobody looks at the bench."""
        self._device.prepare()
        none = np.zeros(4)
        bench = self._bench(np.zeros(len(self._shown) + 1, dtype=np.int64), 0, none, none)
        run_steps(
            self.law, bench, self.references, 0.0, self.period_s, 0, self.drives, self.angles, self._ring,
            self._shared,
        )  # fmt: skip

    @property
    def running(self) -> bool:
        """Tell whether it has not ended yet."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def skipped_last(self) -> int:
        """Steps that fell due before the end, and were not taken."""
        return int(self._shared[SKIPPED])

    def drain(self) -> FloatArray:
        """Return the records since the last time, (n, `MORE` + joints + numbers of `take_step`).

        Who takes them has looked at the bench: the loop goes on for `UNWATCHED_S`.
        """
        self._shared[WATCHED_NS] = time.monotonic_ns()
        head, tail = int(self._shared[HEAD]), int(self._shared[TAIL])
        rows = np.arange(tail, head) % len(self._ring)
        found = self._ring[rows]
        self._shared[TAIL] = head
        return found

    def end(self) -> None:
        """Stop it, if it runs, and give the actuator back to its driver."""
        self._shared[STOP] = 1
        if self._wire is not None and self.status != GOOD:
            self._wire.state[HALT] = 1.0
        if self._thread is not None:
            self._thread.join(1.0)
            sys.setswitchinterval(self._switch_s)
            _calm(self._hurried)
        for name in self._shown:
            cast("Showing", self.rig.sensors[name]).show(None)
        self._device.take_back()

    def check(self) -> None:
        """Raise what kept the thread from running at all."""
        if self._failure is not None:
            raise self._failure

    def _bench(
        self, channels_at: IntArray, send: int, state: FloatArray, parameters: FloatArray
    ) -> LiveBench:
        views = [newest.view for newest in self._shown.values()]
        return LiveBench(
            tuple(one.number for one in views), tuple(one.made_s for one in views),
            tuple(one.heard_s for one in views), tuple(one.values for one in views), channels_at,
            self._bell.file, send, state, parameters,
        )  # fmt: skip

    def _run(
        self, law: Law, bench: LiveBench, references: FloatArray, start_s: float, period_s: float, steps: int
    ) -> None:
        with contextlib.suppress(OSError, AttributeError):  # without the right to it the loop has to share
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        try:
            self.status = run_steps(
                law, bench, references, start_s, period_s, steps, self.drives, self.angles, self._ring,
                self._shared,
            )  # fmt: skip
        except BaseException as failure:  # told by `check`, in the runner's thread
            self._failure = failure


def _hurry() -> list[int]:
    """Let all threads of this process go before other processes, as far as there is the right to; return which do.

    A thread that hears a sensor waits for whichever of them holds Python's lock.
    """
    hurried = []
    for one in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(
                int(one.name), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY_OF_PYTHON)
            )
            hurried.append(int(one.name))
    return hurried


def _calm(threads: Sequence[int]) -> None:
    for one in threads:
        with contextlib.suppress(OSError):  # it has ended
            os.sched_setscheduler(one, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))


def channel_places(rig: Rig) -> Mapping[str, int]:
    """Return where each channel stands in the row of all."""
    names = [f"{name}.{channel.name}" for name, one in rig.sensors.items() for channel in one.channels]
    return {name: place for place, name in enumerate(names)}


def require_real_time(rig: Rig, joints: Sequence[str]) -> HandingOver:
    """Return the actuator of a loop; SpecError if a device cannot take part in one that runs in real time."""
    if sys.platform != "linux":
        raise refusal("real time on anything but Linux")
    for name, sensor in rig.sensors.items():
        if not isinstance(sensor, Showing):
            raise refusal(f"{name} in real time: its driver does not show its samples as they come")
    for actuator in rig.actuators.values():
        if set(actuator.joints) == set(joints):
            if not isinstance(actuator, HandingOver):
                raise refusal(
                    f"{actuator.name} in real time: its driver does not let a loop send its set-points"
                )
            return actuator
    raise refusal(
        "joints of several devices in real time, or of one that has more joints than the gait moves"
    )
