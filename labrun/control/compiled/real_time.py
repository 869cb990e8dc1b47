"""A compiled loop on a bench: a thread without interpreter looks, computes and sends; Python keeps its record.

The thread shares memory with Python: sensors' newest samples on one side, a ring of records on the other. What Python
does meanwhile, and how long it holds its lock, moves no step.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.control.compiled.law import refusal
from labrun.control.compiled.stepping import FULL, GOOD, STOPPED, UNSENT, Law, take_step
from labrun.devices.compiled_wire import HALT, NOT_TAKEN, SENT, CompiledWire, HandingOver, Showing
from labrun.devices.newest import SLOTS, Newest
from labrun.devices.system_calls import clock_s, wait_until
from labrun.models.engine import call_model
from labrun.runner import Rig

HEAD, TAIL, STOP, SKIPPED = range(4)
"""Places of what both sides share: records written, records read, whether to stop, steps skipped at the end."""
MORE = 5
"""Numbers of a record before those of `take_step`: begin of the step (trial time), age of the newest sample when the
command was sent, how late the step began (s), whether its command came too late or not at all, steps skipped before."""
_RING_S = 2.0
_SPIN_S = 1.5e-4
"""Waking up takes the system some 0.05 to 0.1 ms."""
_PRIORITY = 50


class LiveBench(NamedTuple):
    """What a loop reads and writes, as compiled code sees it.

    Attributes
    ----------
    number, made_s, values : (sensors, ...)
        See `labrun.devices.newest.NewestView`; of all sensors.
    channels_at : (sensors + 1,)
        Where each one's channels begin among all channels.
    send, state, parameters
        See `labrun.devices.compiled_wire.CompiledWire`.
    """

    number: tuple[IntArray, ...]
    made_s: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]
    channels_at: IntArray
    send: int
    state: FloatArray
    parameters: FloatArray


@kernel
def run_steps(
    law: Law, bench: LiveBench, references: FloatArray, start_s: float, period_s: float, steps: int,
    drives: FloatArray, angles: FloatArray, ring: FloatArray, shared: IntArray,
) -> int:  # fmt: skip
    """Take all steps of a trial when they are due; return `GOOD` or why it ended before.

    A step that is late is taken as soon as can be; those that fell due meanwhile are skipped and counted.
    """
    joints = len(angles)
    latest = np.full(bench.channels_at[-1], np.nan)
    latest_s = np.full(len(bench.number), -np.inf)
    nothing, said = np.zeros(1), np.zeros(1)
    number = 0
    while number < steps:
        now_s = wait_until(start_s + number * period_s, _SPIN_S)
        if shared[STOP] != 0:
            return STOPPED
        newest = min(int((now_s - start_s) / period_s + 1e-9), steps)
        skipped = max(0, newest - number)
        number += skipped
        if number >= steps:
            shared[SKIPPED] += skipped
            break
        if shared[HEAD] - shared[TAIL] >= len(ring):
            return FULL
        made_s = np.inf
        for sensor in range(len(bench.number)):
            _look(bench, sensor, start_s, latest, latest_s)
        for sensor in law.wiring.sensor:
            made_s = min(made_s, latest_s[sensor])
        record = ring[shared[HEAD] % len(ring)]
        status = take_step(
            law, now_s - start_s, period_s, references[number], latest, latest_s, drives, angles,
            record[MORE + joints :],
        )  # fmt: skip
        if status != GOOD:
            return status
        call_model(bench.send, clock_s(), bench.state, angles, bench.parameters, nothing, said)
        if said[0] != SENT and said[0] != NOT_TAKEN:
            return UNSENT + int(said[0])
        sent_s = clock_s()
        due_s = start_s + number * period_s
        number += 1
        record[0], record[1], record[2] = now_s - start_s, sent_s - start_s - made_s, now_s - due_s
        missed = said[0] != SENT or sent_s > start_s + (number + 1e-9) * period_s
        record[3], record[4] = 1.0 if missed else 0.0, skipped
        for j in range(joints):
            record[MORE + j] = angles[j]
        clock_s()  # a call to the system: the record is in memory before its number
        shared[HEAD] += 1
    return GOOD


@kernel
def _look(bench: LiveBench, sensor: int, start_s: float, latest: FloatArray, latest_s: FloatArray) -> None:
    """Take over a sensor's newest sample."""
    count = bench.number[sensor][0]
    if count > 0:
        row, begin = (count - 1) % SLOTS, bench.channels_at[sensor]
        latest_s[sensor] = bench.made_s[sensor][row] - start_s
        for column in range(bench.values[sensor].shape[1]):
            latest[begin + column] = bench.values[sensor][row, column]


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
    drives
        Where they are.
    angles : (joints,)
        Where the joints were told to be, rad.
    period_s
        Of the loop.

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
    _shared: IntArray = field(default_factory=lambda: np.zeros(4, dtype=np.int64))
    _failure: BaseException | None = None
    _thread: threading.Thread | None = None
    _wire: CompiledWire | None = None

    def __post_init__(self) -> None:
        self._device = require_real_time(self.rig, self.joints)
        rows = max(64, round(_RING_S / self.period_s))
        width = MORE + len(self.joints) + 3 * len(self.law.wiring.channel) + 2 * len(self.drives) + 5
        self._ring = np.empty((rows, width))
        self._shown = {name: Newest(len(one.channels)) for name, one in self.rig.sensors.items()}

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
        views = [newest.view for newest in self._shown.values()]
        widths = [one.values.shape[1] for one in views]
        bench = LiveBench(
            tuple(one.number for one in views), tuple(one.made_s for one in views),
            tuple(one.values for one in views), np.cumsum([0, *widths]), wire.send, wire.state, wire.parameters,
        )  # fmt: skip
        arguments = (self.law, bench, self.references, start_s, self.period_s)
        self._thread = threading.Thread(
            target=self._run, args=(*arguments, len(self.references)), daemon=True, name="compiled loop"
        )
        self._thread.start()

    def compile(self) -> None:
        """Have it compiled, with no step taken: seconds the first time, in which nobody looks at the bench."""
        self._device.prepare()
        views = [newest.view for newest in self._shown.values()]
        none = np.zeros(4)
        bench = LiveBench(
            tuple(one.number for one in views), tuple(one.made_s for one in views),
            tuple(one.values for one in views), np.zeros(len(views) + 1, dtype=np.int64), 0, none, none,
        )  # fmt: skip
        run_steps(
            self.law, bench, self.references, 0.0, self.period_s, 0, self.drives, self.angles, self._ring,
            self._shared,
        )  # fmt: skip

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def skipped_last(self) -> int:
        """Steps that fell due before the end, and were not taken."""
        return int(self._shared[SKIPPED])

    def drain(self) -> FloatArray:
        """Return the records since the last time, (n, `MORE` + joints + numbers of `take_step`)."""
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
        for name in self._shown:
            cast("Showing", self.rig.sensors[name]).show(None)
        self._device.take_back()

    def check(self) -> None:
        """Raise what kept the thread from running at all."""
        if self._failure is not None:
            raise self._failure

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
