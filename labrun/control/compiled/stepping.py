"""One step of a compiled loop: newest samples in, set-points of the joints and a record out."""

import math
from typing import NamedTuple

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import kernel
from labrun.models.engine import call_model

GOOD, LOST_ORIENTATION, NOT_FINITE = range(3)
"""What `take_step` returns: all well; the feedback has no direction; the controller asks for no finite number, which is
told with the drive's place added."""
STOPPED, FULL, UNWATCHED, UNSENT = 100, 101, 102, 200
"""Why a loop in real time ended, beside that: it was told to; nobody reads its records; nobody looks at the bench;
`UNSENT` + what the device's
`CompiledWire.send` said."""

SAMPLES, STEPS, TRAININGS, CLAMPED, WRITTEN, OLDEST, UNSOLVED = range(7)
"""Places in `Affine.counts` and `Wiring.counts`: samples learned from, steps taken, trainings, steps at which a limit
of a joint bounded the set-point, samples of the measured drives kept, number of the window's oldest sample,
samples after which the least squares had no solution."""

_REFRESH = 2048
"""Samples after which the sums of a window are formed anew: what is added and taken away again leaves rounding."""
_SAME_S = 1e-9
_LEAST_LENGTH = 0.1
"""Length below which four numbers are no unit quaternion."""
PID, AFFINE = range(2)


class Wiring(NamedTuple):
    """What a loop reads, and what it moves.

    Attributes
    ----------
    channel, sensor : (components,)
        Where each number of the feedback stands among all channels, and which sensor it is of.
    scale, tare : (components,)
        Feedback = (channel - tare) * scale.
    orientation
        Whether the four components are a quaternion, to be made one of length 1 with a first number >= 0.
    low, high
        Bounds of the drives.
    most
        How far a drive may go in a step; infinite if it may go anywhere.
    gait : (joints, drives + 1)
        Angle of each joint, rad: a number for each drive, and a constant.
    joint_low, joint_high, joint_most : (joints,)
        Limits of each joint (rad), and how far it may turn in a step.
    """

    channel: IntArray
    sensor: IntArray
    scale: FloatArray
    tare: FloatArray
    orientation: bool
    low: float
    high: float
    most: float
    gait: FloatArray
    joint_low: FloatArray
    joint_high: FloatArray
    joint_most: FloatArray
    counts: IntArray


class Affine(NamedTuple):
    """An affine network on top of an analytic inverse, and its learning by exact least squares over a window.

    The same as `labrun.learned.SlidingAffine`, sample by sample and in place.

    Attributes
    ----------
    weights, start : (inputs + 1, outputs)
        In force now, and those of the file; scaled, the last row is the bias.
    gram, moment : (inputs + 1, inputs + 1), (inputs + 1, outputs)
        Sums over the window.
    z, e, z_s : (capacity, inputs + 1), (capacity, outputs), (capacity,)
        Samples of the window, and when they were made; of one row where samples count for ever.
    order : (inputs,)
        Which component of the loop each input is.
    place : (drives,)
        Which output each drive is.
    nominal
        Address of the inverse; 0 for none.
    measured, measured_sensor, factor : (outputs,)
        Which channel measures each output, of which sensor, and what it is multiplied by.
    recent_s, recent : (kept,), (kept, outputs)
        Newest samples of the measured drives, between which the moment of a feedback is found.
    learned_s : (2,)
        When the newest sample learned from was made, and since when its weights have been in force.
    history_s, every, ridge, learns
        As in the file; history_s 0: samples count for ever.
    """

    weights: FloatArray
    start: FloatArray
    gram: FloatArray
    moment: FloatArray
    z: FloatArray
    e: FloatArray
    z_s: FloatArray
    input_mean: FloatArray
    input_scale: FloatArray
    output_mean: FloatArray
    output_scale: FloatArray
    order: IntArray
    place: IntArray
    nominal: int
    measured: IntArray
    measured_sensor: IntArray
    factor: FloatArray
    recent_s: FloatArray
    recent: FloatArray
    learned_s: FloatArray
    counts: IntArray
    history_s: float
    every: int
    ridge: float
    learns: bool


class Pid(NamedTuple):
    """A PID controller for each drive: rows of `keys` and of `memory`.

    Attributes
    ----------
    keys : (drives, 9)
        p, i, d, whether i counts per second, bias, whether the rate is of the error, filter time (s), anti-windup (0
        none, 1 conditional, 2 back-calculation), its time (s).
    memory : (drives, 4)
        Integral, rate, signal before, whether there was one.
    increment
        Whether the output is added to the drive as it stands.
    """

    keys: FloatArray
    memory: FloatArray
    increment: bool


class Law(NamedTuple):
    """A whole compiled loop; `kind` says which of the controllers is in charge."""

    wiring: Wiring
    kind: int
    pid: Pid
    affine: Affine


@kernel
def take_step(  # noqa: PLR0912 - one function, so that nothing is handed from call to call
    law: Law, now_s: float, dt_s: float, reference: FloatArray, latest: FloatArray, latest_s: FloatArray,
    missed: FloatArray, missed_s: float, drives: FloatArray, angles: FloatArray, record: FloatArray,
) -> int:  # fmt: skip
    """Take one step.

    Parameters
    ----------
    law
        The loop; what it remembers is changed in place.
    now_s, dt_s
        Time of the trial, and since the step before.
    reference : (components,)
        Now.
    latest : (channels,)
        Newest sample of every channel.
    latest_s : (sensors,)
        When each sensor's newest sample was made, time of the trial.
    missed, missed_s : (channels,)
        A sample of the feedback that no step has learned from, since a newer one came with it, and when it was made:
        this step learns from it. -inf: there is none, and it learns from the newest.
    drives : (drives,)
        Where the drives stand; set to where they go.
    angles : (joints,)
        Where the joints were told to be, rad; set to the new set-points.
    record : (3 * components + 2 * drives + 5,)
        Reference, feedback, error, drive, requested, and: age of the weights, age of the newest sample in them,
        how long they took (not known here), trainings, whether it learns.

    Returns
    -------
    int
        `GOOD`, or why drives and angles were left as they were.
    """
    wiring = law.wiring
    count, outs, joints = len(wiring.channel), len(drives), len(angles)
    feedback = np.empty(count)
    if not _feedback(wiring, latest, feedback):
        return LOST_ORIENTATION
    feedback_s = np.inf
    for i in range(count):
        feedback_s = min(feedback_s, latest_s[wiring.sensor[i]])
    wanted = np.empty(outs)
    if law.kind == AFFINE:
        if missed_s > -np.inf:
            lesson = np.empty(count)
            taught = _feedback(wiring, missed, lesson) and _learn(
                law.affine, lesson, missed_s, latest, latest_s, True
            )
        else:
            taught = _learn(law.affine, feedback, feedback_s, latest, latest_s, False)
        if taught:
            law.affine.learned_s[1] = now_s
        _affine(law.affine, now_s, reference, wanted)
    else:
        _pid(law.pid, dt_s, reference, feedback, drives, wiring.low, wiring.high, wanted)
    for i in range(outs):
        if not math.isfinite(wanted[i]):
            return NOT_FINITE + i
    for i in range(outs):
        goal = min(max(wanted[i], wiring.low), wiring.high)
        drives[i] = min(max(goal, drives[i] - wiring.most), drives[i] + wiring.most)
    bounded = False
    for j in range(joints):
        goal = wiring.gait[j, outs]
        for i in range(outs):
            goal += wiring.gait[j, i] * drives[i]
        inside = min(max(goal, wiring.joint_low[j]), wiring.joint_high[j])
        inside = min(max(inside, angles[j] - wiring.joint_most[j]), angles[j] + wiring.joint_most[j])
        bounded = bounded or abs(inside - goal) > 1e-9
        angles[j] = inside
    if bounded:
        wiring.counts[CLAMPED] += 1
    if law.kind == PID:
        _applied(law.pid, dt_s, wanted, drives)
    wiring.counts[STEPS] += 1
    for i in range(count):
        record[i], record[count + i] = reference[i], feedback[i]
        record[2 * count + i] = reference[i] - feedback[i]
    for i in range(outs):
        record[3 * count + i], record[3 * count + outs + i] = drives[i], wanted[i]
    more = 3 * count + 2 * outs
    affine = law.affine
    if law.kind == AFFINE and affine.learns:
        trained = affine.counts[TRAININGS]
        record[more] = now_s - affine.learned_s[1]
        record[more + 1] = affine.learned_s[1] - affine.learned_s[0] if trained > 0 else np.nan
        record[more + 2] = np.nan
        record[more + 3], record[more + 4] = trained, 1.0
    else:
        record[more : more + 5] = np.nan
    return GOOD


@kernel
def _feedback(wiring: Wiring, row: FloatArray, feedback: FloatArray) -> bool:
    """Write the feedback that a row of all channels makes; False if it has no direction."""
    for i in range(len(feedback)):
        feedback[i] = (row[wiring.channel[i]] - wiring.tare[i]) * wiring.scale[i]
    if wiring.orientation:
        length = math.sqrt(feedback[0] ** 2 + feedback[1] ** 2 + feedback[2] ** 2 + feedback[3] ** 2)
        if not length > _LEAST_LENGTH:
            return False
        if feedback[0] < 0.0:
            length = -length
        for i in range(4):
            feedback[i] /= length
    return True


@kernel
def _affine(law: Affine, now_s: float, reference: FloatArray, wanted: FloatArray) -> None:
    """Write what the network says to the reference."""
    ins = len(law.order)
    nominal = np.zeros(len(wanted))
    if law.nominal != 0:
        call_model(law.nominal, now_s, reference, reference, reference, reference, nominal)
    for i in range(len(wanted)):
        k = law.place[i]
        value = law.weights[ins, k]
        for j in range(ins):
            value += law.weights[j, k] * (reference[law.order[j]] - law.input_mean[j]) / law.input_scale[j]
        wanted[i] = nominal[i] + value * law.output_scale[k] + law.output_mean[k]


@kernel
def _learn(
    law: Affine,
    feedback: FloatArray,
    feedback_s: float,
    latest: FloatArray,
    latest_s: FloatArray,
    missed: bool,
) -> bool:
    """Take a sample into the window, and solve for the weights; a sample is learned from once.

    Parameters
    ----------
    feedback, feedback_s
        The newest, or, with `missed`, one before it that nothing was learned from.

    Returns
    -------
    bool
        Whether there are new weights.
    """
    if not law.learns:
        return False
    outs, kept = len(law.measured), len(law.recent_s)
    made_s = latest_s[law.measured_sensor[0]]
    written = law.counts[WRITTEN]
    if written == 0 or made_s > law.recent_s[(written - 1) % kept]:
        law.recent_s[written % kept] = made_s
        for k in range(outs):
            law.recent[written % kept, k] = latest[law.measured[k]] * law.factor[k]
        law.counts[WRITTEN] = written = written + 1
    oldest = law.recent_s[written % kept] if written >= kept else law.recent_s[0]
    turn = law.counts[STEPS]
    law.counts[STEPS] = turn + 1
    if turn % law.every != 0 or oldest > feedback_s or not (missed or feedback_s > law.learned_s[0]):
        return False
    target = np.empty(outs)
    _at(law.recent_s, law.recent, written, feedback_s, target)
    if law.nominal != 0:
        nominal = np.zeros(outs)
        call_model(law.nominal, feedback_s, feedback, feedback, feedback, feedback, nominal)
        for i in range(outs):  # the inverse answers in the order of the drives
            target[law.place[i]] -= nominal[i]
    ins = len(law.order)
    size = ins + 1
    z, e = np.empty(size), np.empty(outs)
    for j in range(ins):
        z[j] = (feedback[law.order[j]] - law.input_mean[j]) / law.input_scale[j]
    z[ins] = 1.0
    finite = True
    for k in range(outs):
        value = (target[k] - law.output_mean[k]) / law.output_scale[k]
        for j in range(size):
            value -= z[j] * law.start[j, k]
        e[k] = value
        finite = finite and math.isfinite(value)
    if not finite:  # a sample that is no number teaches nothing
        return False
    held = _windowed(law, z, e, feedback_s)
    found = np.empty_like(law.weights)
    if not _solved(law.gram, law.moment, law.ridge * held, found):  # too few samples without a ridge
        law.counts[UNSOLVED] += 1
        return False
    law.weights[:] = law.start + found
    law.learned_s[0] = max(law.learned_s[0], feedback_s)
    law.counts[TRAININGS] += 1
    return True


@kernel
def _windowed(law: Affine, z: FloatArray, e: FloatArray, made_s: float) -> int:
    """Take a sample into the sums, and out of them those that are older than the history; return how many count."""
    count, oldest, capacity = law.counts[SAMPLES], law.counts[OLDEST], len(law.z_s)
    _add(law.gram, law.moment, z, e, 1.0)
    law.counts[SAMPLES] = count + 1
    if law.history_s <= 0.0:
        return int(count + 1)
    while oldest < count and (
        law.z_s[oldest % capacity] <= made_s - law.history_s + _SAME_S or count - oldest == capacity
    ):
        _add(law.gram, law.moment, law.z[oldest % capacity], law.e[oldest % capacity], -1.0)
        oldest += 1
    row = count % capacity
    law.z[row, :], law.e[row, :], law.z_s[row] = z, e, made_s
    law.counts[OLDEST] = oldest
    if (count + 1) % _REFRESH == 0:
        law.gram[:], law.moment[:] = 0.0, 0.0
        for number in range(oldest, count + 1):
            _add(law.gram, law.moment, law.z[number % capacity], law.e[number % capacity], 1.0)
    return int(count + 1 - oldest)


@kernel
def _add(gram: FloatArray, moment: FloatArray, z: FloatArray, e: FloatArray, sign: float) -> None:
    for j in range(len(z)):
        for i in range(len(z)):
            gram[j, i] += sign * z[j] * z[i]
        for k in range(len(e)):
            moment[j, k] += sign * z[j] * e[k]


@kernel
def _at(times: FloatArray, rows: FloatArray, written: int, time_s: float, found: FloatArray) -> None:
    """Write the row at a time, straight between two of the ring's; the newest one after the last."""
    kept = len(times)
    after = (written - 1) % kept
    found[:] = rows[after]
    if time_s >= times[after]:
        return
    for back in range(1, min(written, kept)):
        before = (written - 1 - back) % kept
        if times[before] <= time_s:
            span = times[after] - times[before]
            share = (time_s - times[before]) / span if span > 0.0 else 0.0
            for k in range(len(found)):
                found[k] = rows[before, k] + share * (rows[after, k] - rows[before, k])
            return
        after = before
    found[:] = rows[after]


@kernel
def _solved(gram: FloatArray, moment: FloatArray, ridge: float, found: FloatArray) -> bool:
    """Solve ``(gram + ridge I) found = moment`` by Cholesky's way; False where that is not possible."""
    size, outs = moment.shape
    low = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            value = gram[i, j] + (ridge if i == j else 0.0)
            for k in range(j):
                value -= low[i, k] * low[j, k]
            if i == j:
                if not value > 0.0:
                    return False
                low[i, i] = math.sqrt(value)
            else:
                low[i, j] = value / low[j, j]
    for o in range(outs):
        for i in range(size):
            value = moment[i, o]
            for k in range(i):
                value -= low[i, k] * found[k, o]
            found[i, o] = value / low[i, i]
        for i in range(size - 1, -1, -1):
            value = found[i, o]
            for k in range(i + 1, size):
                value -= low[k, i] * found[k, o]
            found[i, o] = value / low[i, i]
            if not math.isfinite(found[i, o]):
                return False
    return True


@kernel
def _pid(
    law: Pid, dt_s: float, reference: FloatArray, feedback: FloatArray, drives: FloatArray, low: float,
    high: float, wanted: FloatArray,
) -> None:  # fmt: skip
    """As `labrun.control.PidController`, for each drive."""
    for i in range(len(wanted)):
        p, gain, d, per_second, bias, of_error, filter_s, windup, _ = law.keys[i]
        error = reference[i] - feedback[i]
        signal = error if of_error else -feedback[i]
        if law.memory[i, 3] > 0.0:
            raw = (signal - law.memory[i, 2]) / dt_s
            law.memory[i, 1] += (raw - law.memory[i, 1]) * dt_s / (filter_s + dt_s)
        law.memory[i, 2], law.memory[i, 3] = signal, 1.0
        base = bias + p * error + d * law.memory[i, 1]
        if law.increment:
            base += drives[i]
        growth = gain * error * (dt_s if per_second else 1.0)
        found = base + law.memory[i, 0] + growth
        outward = (found > high and growth > 0.0) or (found < low and growth < 0.0)
        if windup != 1.0 or not outward:
            law.memory[i, 0] += growth
        wanted[i] = base + law.memory[i, 0]


@kernel
def _applied(law: Pid, dt_s: float, wanted: FloatArray, drives: FloatArray) -> None:
    for i in range(len(wanted)):
        if law.keys[i, 7] == 2.0 and law.keys[i, 1] != 0.0:
            law.memory[i, 0] += min(1.0, dt_s / law.keys[i, 8]) * (drives[i] - wanted[i])
