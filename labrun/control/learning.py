"""Train a network while its loop runs, in a separate process on a bench."""

import contextlib
import math
import multiprocessing
import signal
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import ExperimentError
from labrun.learned import Network, SlidingAffine

_READY_S = 30.0
_IDLE_S = 2e-4
_RING = 1 << 14
"""Samples that fit between loop and learner: 100 s at 160 a second."""
_HEAD = 8
_GIVEN, _STOP, _VERSION, _READY = range(4)
_SLOT_HEAD = 3
"""Of each of the two slots for weights: newest sample, how long they took, how many trainings."""


@dataclass(frozen=True, slots=True)
class LearnerTask:
    """What to learn: an affine network's weights over a window of samples, see `SlidingAffine`."""

    network: Network
    window: int | None
    ridge: float

    @property
    def start(self) -> Network:
        """The affine map to begin with. Raises ExperimentError: the network is none."""
        try:
            return self.network.collapsed()
        except ValueError as error:
            raise ExperimentError(
                f"only affine networks can be trained during a loop: {error}",
                hint='fit it with activation = "identity"',
            ) from error


class Learner(ABC):
    """Takes samples and gives weights.

    Attributes
    ----------
    lag_s
        How old the newest sample in the weights was when they came into force.
    training_s
        How long they took.
    trainings
        How many have come into force.
    alive
        Whether there are more to come.
    remarks
        What went wrong, for people.
    """

    def __init__(self, task: LearnerTask) -> None:
        self._task = task
        self._start = task.start
        self.lag_s = self.training_s = math.nan
        self.trainings = 0
        self.alive = True
        self.remarks: list[str] = []

    def begin(self) -> None:  # noqa: B027
        """Start; return at once."""

    def ready(self) -> bool:
        """Tell whether the learner is ready. Raises ExperimentError: it failed to start."""
        return True

    def end(self) -> None:  # noqa: B027
        """End, at once."""

    @abstractmethod
    def give(self, time_s: float, inputs: Sequence[float], outputs: Sequence[float]) -> None:
        """Hand over a sample and the time of the trial at which it was made."""

    @abstractmethod
    def newest(self, now_s: float) -> Network | None:
        """Return new weights since the last call, if any."""

    def _accepted(self, network: Network) -> Network | None:
        if network.finite:
            return network
        self._give_up("it returned weights that are not finite numbers")
        return None

    def _give_up(self, why: str) -> None:
        if self.alive:
            self.alive = False
            kept = f"those of training {self.trainings}" if self.trainings else "those of the file"
            self.remarks.append(f"the learner ended: {why}; the loop went on with its last weights, {kept}")


class InlineLearner(Learner):
    """Learns within the step, and hands the weights out as late as `training_s` says: for simulated time."""

    def __init__(self, task: LearnerTask, training_s: float) -> None:
        super().__init__(task)
        self._takes_s = training_s
        self._solver = SlidingAffine(self._start, task.window, task.ridge)
        self._waiting: list[tuple[Sequence[float], Sequence[float]]] = []
        self._newest_s = -math.inf
        self._due: deque[tuple[float, float, Network]] = deque()

    def give(self, time_s: float, inputs: Sequence[float], outputs: Sequence[float]) -> None:
        """Keep a sample for the next training."""
        self._waiting.append((inputs, outputs))
        self._newest_s = time_s

    def newest(self, now_s: float) -> Network | None:
        """Train if the training before is over; return the weights that are due."""
        newest = None
        if self._due and self._due[0][0] <= now_s:
            _, sample_s, network = self._due.popleft()
            newest = self._accepted(network)
            if newest is not None:
                self.lag_s, self.training_s = now_s - sample_s, self._takes_s
                self.trainings += 1
        if not self._due and self._waiting and self.alive:
            inputs, outputs = zip(*self._waiting, strict=True)
            self._waiting.clear()
            self._solver.add(np.array(inputs), np.array(outputs))
            self._due.append((now_s + self._takes_s, self._newest_s, self._solver.solved()))
        return newest


class ProcessLearner(Learner):
    """Learns in a separate process; samples and weights are exchanged through shared memory without waiting.

    A loop whose learner dies goes on with the weights it has.
    """

    def __init__(self, task: LearnerTask) -> None:
        super().__init__(task)
        self._inputs = len(self._start.inputs.mean)
        self._outputs = len(self._start.outputs.mean)
        self._view: _Shared | None = None
        self._process: Any = None
        self._given = 0
        self._version = 0
        self._looked_s = -math.inf
        self._until_s = math.inf

    def begin(self) -> None:
        """Start the process."""
        self._view = _Shared(self._inputs, self._outputs)
        self._view.all[:] = 0.0
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(
            target=learn, args=(self._view.memory.name, self._task), daemon=True, name="labrun learner"
        )
        self._process.start()
        # a process comes up in real time, whatever clock the loop runs by
        self._until_s = time.monotonic() + _READY_S

    def ready(self) -> bool:
        """Tell whether the process is ready; see `Learner.ready`."""
        if self._view is None or self._view.all[_READY]:
            return True
        if not self._process.is_alive():
            how = _how_it_ended(self._process.exitcode)
            self.end()
            raise ExperimentError(
                f"the learning process ended before it started ({how})",
                hint="the loop was not closed yet; what the process wrote, if anything, stands above",
            )
        if time.monotonic() > self._until_s:
            self.end()
            raise ExperimentError(
                f"the learning process did not start within {_READY_S:g} s",
                hint="the loop was not closed yet; close programs that keep this computer busy, then try again",
            )
        return False

    def end(self) -> None:
        """End the process, and give the memory back."""
        if self._view is None:
            return
        self._view.all[_STOP] = 1.0
        if self._process is not None:
            self._process.join(1.0)
            if self._process.is_alive():
                self._process.kill()
                self._process.join(1.0)
        self._view.close()
        with contextlib.suppress(FileNotFoundError):
            self._view.memory.unlink()
        self._view = None

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return None if self._process is None else self._process.pid

    def give(self, time_s: float, inputs: Sequence[float], outputs: Sequence[float]) -> None:
        """Put a sample into the ring; the oldest is overwritten."""
        if self._view is None:
            return
        row = self._view.ring[self._given % _RING]
        row[0] = time_s
        row[1 : 1 + self._inputs] = inputs
        row[1 + self._inputs :] = outputs
        self._given += 1
        self._view.all[_GIVEN] = self._given

    def newest(self, now_s: float) -> Network | None:
        """Return new weights, if any."""
        view = self._view
        if view is None or not self.alive:
            return None
        version = int(view.all[_VERSION])
        if version == self._version:
            if now_s - self._looked_s > 0.05:  # asking after a process costs more than a step has
                self._looked_s = now_s
                if not self._process.is_alive():
                    self._give_up(
                        f"its process died ({_how_it_ended(self._process.exitcode)}) after {now_s:.2f} s"
                    )
            return None
        head, weights = view.weights(version)
        self._version = version
        network = self._accepted(replace(self._start, weights=(weights[:-1],), biases=(weights[-1],)))
        if network is not None:
            self.lag_s, self.training_s = now_s - head[0], head[1]
            self.trainings = int(head[2])
        return network


def _how_it_ended(exit_code: int) -> str:
    """Return how a process ended, in words: Python gives the number of a signal as a negative exit code."""
    return f"exit code {exit_code}" if exit_code >= 0 else f"killed by {signal.Signals(-exit_code).name}"


class _Shared:
    """The memory between loop and learner: a head, two slots for weights, a ring of samples.

    Weights are written to the place that is not in force, and then the version goes up: whoever reads has them whole,
    unless two trainings end while he copies, and then he copies again.
    """

    def __init__(self, inputs: int, outputs: int, name: str | None = None) -> None:
        slot, row = _SLOT_HEAD + (inputs + 1) * outputs, 1 + inputs + outputs
        size = _HEAD + 2 * slot + _RING * row
        self.memory = SharedMemory(name, create=name is None, size=8 * size)
        self.all: FloatArray = np.ndarray((size,), dtype=np.float64, buffer=self.memory.buf)
        self.ring = self.all[_HEAD + 2 * slot :].reshape(_RING, row)
        self._slot, self._shape = slot, (inputs + 1, outputs)

    def close(self) -> None:
        """Let go of it. Raises BufferError: arrays still look at it."""
        del self.all, self.ring
        self.memory.close()

    def slot_of(self, version: int) -> FloatArray:
        """Return the slot that holds a version."""
        begin = _HEAD + (version % 2) * self._slot
        return self.all[begin : begin + self._slot]

    def weights(self, version: int) -> tuple[list[float], FloatArray]:
        """Return head and weights of a version, or of the one that has overtaken it."""
        while True:
            copied = self.slot_of(version).copy()
            now = int(self.all[_VERSION])
            if now - version < 2:
                break
            version = now
        return copied[:_SLOT_HEAD].tolist(), copied[_SLOT_HEAD:].reshape(self._shape)


def learn(name: str, task: LearnerTask) -> None:
    """Train on whatever samples have come, again and again, until told to stop or the loop's process is gone."""
    parent = multiprocessing.parent_process()
    start = task.start
    inputs = len(start.inputs.mean)
    view = _Shared(inputs, len(start.outputs.mean), name)
    solver = SlidingAffine(start, task.window, task.ridge)
    solver.solved()
    taken, trainings = 0, 0
    view.all[_READY] = 1.0
    # no clock of a loop here: this process waits for memory that another one writes
    looked_s = time.monotonic()
    while view.all[_STOP] == 0.0:
        given = int(view.all[_GIVEN])
        if given == taken:
            time.sleep(_IDLE_S)
            if time.monotonic() - looked_s > 1.0:
                looked_s = time.monotonic()
                if parent is not None and not parent.is_alive():
                    break
            continue
        began_s = time.perf_counter()
        taken = max(taken, given - _RING + 64)
        rows = view.ring[np.arange(taken, given) % _RING]
        solver.add(rows[:, 1 : 1 + inputs], rows[:, 1 + inputs :])
        network = solver.solved()
        taken, trainings = given, trainings + 1
        column = view.slot_of(trainings)
        column[_SLOT_HEAD:] = np.vstack([network.weights[0], network.biases[0]]).ravel()
        column[0], column[1], column[2] = rows[-1, 0], time.perf_counter() - began_s, trainings
        view.all[_VERSION] = trainings
    with contextlib.suppress(BufferError):  # the process ends anyway
        view.close()
