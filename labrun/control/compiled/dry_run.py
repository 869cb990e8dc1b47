"""A trial of a compiled loop in simulated time: bench, sensors and loop advance together, a block in one kernel."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.control.compiled.law import refusal
from labrun.control.compiled.stepping import GOOD, Law, take_step
from labrun.devices import Samples
from labrun.devices.compiled import (
    Ahead,
    CompiledJoints,
    CompiledScene,
    CompiledSensor,
    CompiledStandIn,
)
from labrun.errors import SpecError
from labrun.models.engine import call_model
from labrun.runner import Rig

GOAL, ANGLE, SPEED = range(3)
"""Columns of `BlockBench.shafts`."""


class BlockBench(NamedTuple):
    """A simulated bench and what measures it.

    Attributes
    ----------
    step_s
        Of its time grid.
    advance, state, parameters
        See `labrun.devices.compiled.CompiledScene`.
    servos : (joints, 9)
        See `labrun.devices.compiled.CompiledJoints`.
    shafts : (joints, 3)
        Goal, angle (rad) and speed (rad/s) of each, changed in place.
    measure : (sensors,)
        Address of each.
    numbers, numbers_at : (n,), (sensors,)
        Parameters of all sensors in one row, and where each one's begin.
    feels, feels_at : (n,), (sensors + 1,)
        Which columns of a truth row each feels, likewise.
    channels_at : (sensors,)
        Where each one's channels begin among all channels.
    """

    step_s: float
    advance: int
    state: FloatArray
    parameters: FloatArray
    signals: int
    servos: FloatArray
    shafts: FloatArray
    measure: IntArray
    numbers: FloatArray
    numbers_at: IntArray
    feels: IntArray
    feels_at: IntArray
    channels_at: IntArray


class Arriving(NamedTuple):
    """Samples of all sensors in a block, in the order in which they arrive.

    Attributes
    ----------
    host_s, taken_s : (n,)
    sensor, draws_at : (n,)
        Which sensor's; where its random numbers begin.
    draws
        Random numbers of all.
    """

    host_s: FloatArray
    taken_s: FloatArray
    sensor: IntArray
    draws_at: IntArray
    draws: FloatArray


@kernel
def run_block(
    bench: BlockBench, law: Law, arriving: Arriving, first: int, truth: FloatArray, known: int, start: int,
    per_step: int, steps: int, done: int, references: FloatArray, latest: FloatArray, latest_s: FloatArray,
    drives: FloatArray, angles: FloatArray, measured: FloatArray, records: FloatArray, goals: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Run the grid points from `first` on, as many as `truth` has rows behind its first `known`.

    Parameters
    ----------
    first
        Number of the grid point whose truth stands in row ``known - 1``.
    truth : (known + points, signals + joints)
        Rows of before, and room for those to come.
    start, per_step, steps
        Grid point of the first step of the loop, points from step to step, and how many there are in the trial.
    references : (steps of this block, components)
        The reference at them.
    latest, latest_s
        See `take_step`; times of the trial.
    drives, angles
        Where they stand.
    measured : (samples, channels)
        Gets the samples.
    records : (steps of this block, numbers)
        Gets the records, behind the time of the trial and the time since the newest sample.
    goals : (points, joints)
        Gets what the joints are told.

    Returns
    -------
    int, int
        `GOOD` or why a step failed, after which nothing is commanded any more; steps taken in this block.
    """
    points, joints, sensors = len(truth) - known, len(angles), len(bench.measure)
    status, here, taken = GOOD, 0, 0
    before_and_now = np.empty(2 * joints)
    felt = np.empty(truth.shape[1])
    nothing = np.zeros(1)
    start_s = start * bench.step_s
    for point in range(points):
        grid = first + point
        now_s = grid * bench.step_s
        while here < len(arriving.host_s) and arriving.host_s[here] <= now_s:
            sensor = arriving.sensor[here]
            _felt(bench, truth, known + point, grid, arriving.taken_s[here], sensor, felt)
            call_model(
                bench.measure[sensor], arriving.taken_s[here], felt, arriving.draws[arriving.draws_at[here] :],
                bench.numbers[bench.numbers_at[sensor] :], nothing, measured[here],
            )  # fmt: skip
            begin = bench.channels_at[sensor]
            end = bench.channels_at[sensor + 1] if sensor + 1 < sensors else len(latest)
            for column in range(end - begin):
                latest[begin + column] = measured[here, column]
            latest_s[sensor] = arriving.taken_s[here] - start_s
            here += 1
        number = done + taken
        if status == GOOD and number < steps and grid == start + number * per_step:
            record = records[taken]
            record[0] = now_s - start_s
            status = take_step(
                law, now_s - start_s, per_step * bench.step_s, references[taken], latest, latest_s, latest,
                -np.inf, drives, angles, record[2:],
            )  # fmt: skip
            newest_s = np.inf
            for sensor in law.wiring.sensor:
                newest_s = min(newest_s, latest_s[sensor])
            record[1] = now_s - start_s - newest_s
            if status == GOOD:
                taken += 1
        row = truth[known + point]
        for j in range(joints):
            sign = bench.servos[j, 8]
            before_and_now[j] = sign * bench.shafts[j, ANGLE]
            _turn(bench.servos[j], bench.shafts[j], angles[j], grid, bench.step_s)
            before_and_now[joints + j] = sign * bench.shafts[j, ANGLE]
            row[bench.signals + j] = bench.shafts[j, ANGLE]
            goals[point, j] = angles[j]
        call_model(
            bench.advance,
            (grid + 1) * bench.step_s,
            bench.state,
            before_and_now,
            bench.parameters,
            nothing,
            row,
        )
    return status, taken


@kernel
def _felt(
    bench: BlockBench, truth: FloatArray, known: int, grid: int, taken_s: float, sensor: int, felt: FloatArray
) -> None:
    """Write what a sensor feels at a time, straight between two rows of which the last, `grid`, is row known - 1."""
    place = known - 1 - (grid - taken_s / bench.step_s)
    low = min(max(math.floor(place), 0), max(known - 2, 0))
    share = min(max(place - low, 0.0), 1.0)
    high = min(low + 1, known - 1)
    begin = bench.feels_at[sensor]
    for i in range(bench.feels_at[sensor + 1] - begin):
        column = bench.feels[begin + i]
        felt[i] = truth[low, column] + share * (truth[high, column] - truth[low, column])


@kernel
def _turn(servo: FloatArray, shaft: FloatArray, told: float, grid: int, step_s: float) -> None:
    """Turn a shaft for a step: the command is taken note of once in so many steps, in whole steps of its own."""
    if grid % int(servo[7]) == 0:
        goal = round(told / servo[4]) * servo[4]
        if abs(goal - shaft[GOAL]) > servo[5]:
            shaft[GOAL] = goal
    error = shaft[GOAL] - shaft[ANGLE]
    next_error = servo[0] * error + servo[1] * shaft[SPEED]
    shaft[SPEED] = servo[2] * error + servo[3] * shaft[SPEED]
    if abs(shaft[SPEED]) > servo[6]:
        shaft[SPEED] = math.copysign(servo[6], shaft[SPEED])
        next_error = error - shaft[SPEED] * step_s
    shaft[ANGLE] = shaft[GOAL] - next_error


_BLOCK_S = 0.2
_KEPT_ROWS = 512
"""Truth of before a block that samples still under way were made in."""
_WHOLE = 1e-6


@dataclass(frozen=True, slots=True)
class BlockResult:
    """What a block brought.

    Attributes
    ----------
    status
        `labrun.control.compiled.stepping.GOOD`, or why a step failed.
    records : (steps, numbers)
        Time of the trial, time since the newest sample was made, and what `take_step` records.
    time_s, goals : (points,), (points, joints)
        What the joints were told, rad, from when on; by the clock.
    """

    status: int
    records: FloatArray
    time_s: FloatArray
    goals: FloatArray


@dataclass
class _Sensor:
    device: CompiledStandIn
    form: CompiledSensor


@dataclass
class CompiledDryRun:
    """A bench in simulated time from now on, for the loop of one trial.

    Parameters
    ----------
    rig
        Whose scene, sensors and actuators all have a compiled form.
    joints
        Joints it moves, in the order of its gait.
    period_s
        Of the loop: a whole number of steps of the scene's time grid.

    Raises
    ------
    SpecError
        A scene or device without compiled form, or a period that does not fit.
    """

    rig: Rig
    law: Law
    joints: tuple[str, ...]
    period_s: float
    _sensors: list[_Sensor] = field(default_factory=list)

    def __post_init__(self) -> None:
        require_compiled(self.rig, self.joints, self.period_s)
        scene: Any = self.rig.scene
        self._scene = scene
        self._step_s = float(scene.step_s)
        self._per_step = round(self.period_s / self._step_s)
        for device in self.rig.sensors.values():
            self._sensors.append(_Sensor(cast("CompiledStandIn", device), cast("Any", device).compiled()))
        now = self.rig.clock.now()
        scene.observe(list(scene.signals)[:1], np.array([now]))  # the bench as far as it has come
        self._grid = scene.compiled().first
        self._owner = {
            joint: cast("CompiledJoints", device)
            for device in self.rig.actuators.values()
            for joint in getattr(device, "joints", ())
            if joint in self.joints
        }

    @property
    def now_s(self) -> float:
        """Time that the bench has reached."""
        return float(self._grid * self._step_s)

    def begin(self, lead_s: float, steps: int, channels: int, drives: FloatArray) -> float:
        """Let the loop begin after `lead_s`, with `drives` where they are; return when, by the clock."""
        self._start = self._grid + math.ceil(lead_s / self._step_s)
        self._steps, self._done = steps, 0
        self._drives = drives
        self._latest = np.full(channels, np.nan)
        self._latest_s = np.full(len(self._sensors), -np.inf)
        return float(self._start * self._step_s)

    def take_over(self) -> None:
        """Take the bench over from its scene, which knows by now when the recording begins."""
        self._form: CompiledScene = self._scene.compiled()
        self._bench = self._made_bench()
        angle = self._bench.shafts[:, ANGLE]
        self._truth = np.concatenate([self._form.row, angle])[None, :]
        self._angles = angle.copy()

    def block(self, until_s: float, references: Any) -> BlockResult:
        """Run the next block, up to a time at the latest, and hand the samples to their devices.

        `references`: returns the reference at a time of the trial.
        """
        points = min(round(_BLOCK_S / self._step_s), max(1, math.ceil((until_s - self.now_s) / self._step_s)))
        last_s = (self._grid + points - 1) * self._step_s
        ahead = [one.device.ahead(last_s, one.form.draws) for one in self._sensors]
        arriving, order = _in_order(ahead)
        in_block = self._steps_until(self._grid + points) - self._done
        times = [(self._done + i) * self.period_s for i in range(in_block)]
        wanted = np.array([references(t) for t in times], dtype=float)
        if not in_block:
            wanted = np.zeros((0, 1))
        known = len(self._truth)
        truth = np.empty((known + points, self._truth.shape[1]))
        truth[:known] = self._truth
        widest = max(one.form.channels for one in self._sensors)
        measured = np.empty((len(arriving.host_s), widest))
        width = 3 * len(self.law.wiring.channel) + 2 * len(self._drives) + 7
        records = np.empty((in_block, width))
        goals = np.empty((points, len(self.joints)))
        status, taken = run_block(
            self._bench, self.law, arriving, self._grid, truth, known, self._start, self._per_step,
            self._steps, self._done, wanted, self._latest, self._latest_s, self._drives, self._angles,
            measured, records, goals,
        )  # fmt: skip
        time_s = (self._grid + np.arange(points + 1)) * self._step_s
        signals = self._bench.signals
        self._scene.adopt(self._form, truth[known:, :signals])
        for j, joint in enumerate(self.joints):
            angle = truth[known - 1 :, signals + j]
            told = np.concatenate([goals[:1, j], goals[:, j]])
            self._owner[joint].moved(joint, time_s, angle, told)
        self._hand_over(ahead, measured, order)
        self._done += taken
        self._grid += points
        self._truth = truth[-_KEPT_ROWS:].copy()
        return BlockResult(status, records[:taken], time_s[:-1], goals)

    def _steps_until(self, grid: int) -> int:
        """Return how many steps are due before a grid point."""
        return int(min(max(0, -(-(grid - self._start) // self._per_step)), self._steps))

    def _hand_over(self, ahead: Sequence[Ahead], measured: FloatArray, order: Mapping[int, IntArray]) -> None:
        for number, (one, samples) in enumerate(zip(self._sensors, ahead, strict=True)):
            rows = measured[order[number], : one.form.channels]
            values = np.ascontiguousarray(one.device.completed(rows))
            block = Samples(samples.device_time_s, samples.host_time_s, values, lost=samples.lost)
            one.device.deliver(block)

    def _made_bench(self) -> BlockBench:
        scene, joints = self._scene, self.joints
        rows, shafts = [], []
        for joint in joints:
            device = self._owner[joint]
            rows.append(device.compiled_joints(self._step_s)[device.joints.index(joint)])
            angle, speed = device.joint_state(joint, self._grid * self._step_s)
            shafts.append([angle, angle, speed])
        columns = {name: i for i, name in enumerate(scene.signals)}
        feels: list[int] = []
        feels_at, numbers_at, channels_at = [0], [], []
        numbers: list[float] = []
        width = 0
        for one in self._sensors:
            form = one.form
            feels += [columns[name] for name in form.signals]
            feels += [len(columns) + joints.index(name) for name in form.joints]
            feels_at.append(len(feels))
            numbers_at.append(len(numbers))
            numbers += form.parameters.tolist()
            channels_at.append(width)
            width += form.channels
        return BlockBench(
            self._step_s, self._form.advance, self._form.state, self._form.parameters, len(columns),
            np.array(rows), np.array(shafts), np.array([one.form.measure for one in self._sensors]),
            np.array([*numbers, 0.0]), np.array(numbers_at), np.array([*feels, 0]), np.array(feels_at),
            np.array(channels_at),
        )  # fmt: skip


def compiled_places(rig: Rig) -> dict[str, int]:
    """Return where each channel that is measured in a block stands in the row of all."""
    places: dict[str, int] = {}
    for name, device in rig.sensors.items():
        form = cast("Any", device).compiled()
        for channel in device.channels[: form.channels]:
            places[f"{name}.{channel.name}"] = len(places)
    return places


def require_compiled(rig: Rig, joints: Sequence[str], period_s: float) -> None:
    """Raise SpecError unless a rig's scene and devices can take part in a compiled dry run."""
    scene: Any = rig.scene
    why = getattr(scene, "compiled", lambda: "this scene has no compiled form")()
    if isinstance(why, str):
        raise refusal(f"this bench: {why}")
    per_step = period_s / float(scene.step_s)
    if abs(per_step - round(per_step)) > _WHOLE or round(per_step) < 1:
        highest = 1.0 / float(scene.step_s)
        raise SpecError(
            f"{1.0 / period_s:g} steps a second on this scene, whose own step takes {scene.step_s:g} s: a compiled "
            "loop takes a step of its own in a whole number of the scene's",
            hint=f"track.rate_hz = {_rates_near(1.0 / period_s, highest)} would do; without track.compiled, in Python, "
            f"{1.0 / period_s:g} would, too",
        )
    for name, device in rig.sensors.items():
        form = getattr(device, "compiled", lambda name=name: f"{name} has no compiled form")()
        if isinstance(form, str):
            raise refusal(f"this rig: {form}")
        missing = [one for one in form.joints if one not in joints]
        if missing:
            raise refusal(
                f"a rig on which {name} measures {', '.join(missing)}, which the gait does not move"
            )
    for joint in joints:
        owner = [one for one in rig.actuators.values() if joint in getattr(one, "joints", ())]
        if not owner or not hasattr(owner[0], "compiled_joints"):
            raise refusal(f"what drives {joint}")


def _rates_near(rate_hz: float, highest_hz: float) -> str:
    """Return the rates on both sides of one that are the highest, divided by a whole number, and short to write."""
    every = [highest_hz / n for n in range(1, math.ceil(highest_hz) + 1)]
    short = [one for one in every if math.isclose(float(f"{one:g}"), one, rel_tol=1e-12)]
    below, above = [one for one in short if one <= rate_hz], [one for one in short if one >= rate_hz]
    near = dict.fromkeys([*below[:1], *above[-1:], highest_hz])
    return (
        ", ".join(f"{one:g}" for one in list(near)[:-1])
        + (" or " if len(near) > 1 else "")
        + f"{highest_hz:g}"
    )


def _in_order(ahead: Sequence[Ahead]) -> tuple[Arriving, dict[int, IntArray]]:
    """Return all samples in the order in which they arrive, and the rows of each sensor's there."""
    host_s = np.concatenate([one.host_time_s for one in ahead])
    taken_s = np.concatenate([one.taken_s for one in ahead])
    sensor = np.concatenate([np.full(len(one.host_time_s), i, dtype=np.int64) for i, one in enumerate(ahead)])
    draws_at: list[IntArray] = []
    begin = 0
    for one in ahead:
        draws_at.append(begin + one.draws.shape[1] * np.arange(len(one.draws), dtype=np.int64))
        begin += one.draws.size
    order = np.argsort(host_s, kind="stable")
    draws = np.concatenate([*(one.draws.ravel() for one in ahead), np.zeros(1)])
    arriving = Arriving(host_s[order], taken_s[order], sensor[order], np.concatenate(draws_at)[order], draws)
    return arriving, {i: np.flatnonzero(arriving.sensor == i).astype(np.int64) for i in range(len(ahead))}
