"""Bench, sensors and loop together in one kernel: a block of a dry run's time."""

import math
from typing import NamedTuple

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.control.compiled.stepping import GOOD, Law, take_step
from labrun.models.engine import call_model

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
