"""What joint torques are made of, as columns of one linear regression: links, and what the model may lack.

Each joint has rows of its own: its logged torque less what the robot as stated asks for, and the columns that can
explain the difference. All pass the same low pass (see `labrun.gap.robot.inverse_dynamics`).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray, IntArray
from labrun.experiment import condition_key
from labrun.fit import Dataset
from labrun.gap import criteria
from labrun.gap.evidence import correlation_samples
from labrun.gap.robot.inverse_dynamics import (
    Course,
    Cut,
    Moved,
    choose_cut,
    decimated,
    differentiated,
    low_passed,
    motion_cut_hz,
    moves,
    sign_speeds,
    uniform,
)
from labrun.gap.robot.linear_evidence import Gram, LinearEvidence
from labrun.models import InertialRegressor, Robot, RobotTerms

NUISANCE = ("link", "timing", "armature", "damping", "spring")
"""Kinds of columns that every model has: what is stated, within its tolerance."""
WHOLE = -1
"""Joint of a column that belongs to the robot as a whole."""
STRIBECK_SPEEDS = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Stribeck speeds that are tried, as parts of the peak speed."""
_LEAST_PERIODS, _SCANNED_PERIODS, _PERIODS_KEPT = 3.1, 400, 2
"""Of forces that are periodic in the position: fewest periods in 2 pi half-travels, how many are scanned, and how many
of them become candidates."""
_LOAD_INERTIA = 0.1
"""Inertia of a load that is looked for, in units of the robot's whole mass at its largest radius of gyration."""
_SEEN = 1e-6
"""Information of the data about a combination of link parameters, in units of what is stated of it, that is kept."""
_CLASSICAL = ("coulomb", "viscous", "offset")
_COUPLINGS = (1.0, -1.0)
"""Of a motor whose angle is that of its joint plus or minus that of the joint before: belts and differentials."""
_TIMING_SAMPLES = 0.5
"""How late or early the logged torque may act, in samples: whether it is held or runs on is not logged."""


@dataclass(frozen=True)
class Column:
    """A column of the regression.

    Attributes
    ----------
    kind
        ``link`` and ``freed`` (combinations of link parameters within and beyond their tolerances), ``tilt``,
        ``timing``, or what a joint may lack.
    joint
        Place of the joint; `WHOLE` if it belongs to the robot.
    detail
        A speed, a number of periods, a body, or an axis; of a coupled column the sign of the joint before.
    spread
        How far its coefficient may be from zero; infinite if nothing is known.
    phase
        Of a periodic force: 0 for its sine, 1 for its cosine.
    """

    kind: str
    joint: int = WHOLE
    detail: float = 0.0
    spread: float = np.inf
    phase: int = 0


@dataclass(frozen=True)
class JointRows:
    """The rows of one joint in one trial, low-passed and decimated, those left out at which it rests.

    Attributes
    ----------
    time_s : (n,)
    q : (n,)
        Of the joint.
    links : (n, 10 bodies)
        What each inertial parameter asks, in units of how far it may be off.
    own : (n, columns)
    stated, torque : (n,)
        What the robot as stated asks for, and what was logged.
    moving : (all rows,)
        Which rows of the trial these are.
    """

    time_s: FloatArray
    q: FloatArray
    links: FloatArray
    own: FloatArray
    stated: FloatArray
    torque: FloatArray
    moving: NDArray[np.bool_]


@dataclass(frozen=True)
class TorqueLog:
    """A log with torques, ready for regression.

    Attributes
    ----------
    joints
        Names, in the order of the rows.
    rows : per joint, per trial
    own_columns : per joint
        Of `JointRows.own`.
    conditions : per trial
    tolerance : (10 bodies,)
        How far each inertial parameter may be off, SI.
    sign_speed, peak_rate : (joints,)
    courses, moved : per trial
        The trials at their full rate, and their motion.
    dead : per joint
        Why a joint's torque says nothing; "" if it does.
    currents
        Places of the joints of which the log states a motor current in place of a torque.
    torque_units : per joint
        ``N m``, of a slide ``N``.
    """

    joints: tuple[str, ...]
    regressor: InertialRegressor
    rows: tuple[tuple[JointRows, ...], ...]
    own_columns: tuple[tuple[Column, ...], ...]
    conditions: tuple[str, ...]
    cut: Cut
    step_s: float
    tolerance: FloatArray
    sign_speed: FloatArray
    peak_rate: FloatArray
    courses: tuple[Course, ...]
    moved: tuple[Moved, ...]
    dead: tuple[str, ...]
    currents: tuple[int, ...]
    torque_units: tuple[str, ...]

    def scaled(self, factors: FloatArray) -> "TorqueLog":
        """Return the same with the logged torque of each joint multiplied by a factor."""
        made = []
        for rows, columns, factor in zip(self.rows, self.own_columns, factors, strict=True):
            scale = np.array([_by_torque(column.kind, factor) for column in columns])
            made.append(tuple(replace(row, own=row.own * scale, torque=row.torque * factor) for row in rows))
        return replace(self, rows=tuple(made))

    def with_periods(self, residual: Sequence[Sequence[FloatArray]]) -> "TorqueLog":
        """Return the same with columns for forces that are periodic in the position of a joint.

        Parameters
        ----------
        residual : per joint, per trial (n,)
            What is left of the torque; the periods that explain most of it are taken, if they explain a share that
            matters.
        """
        rows, columns = list(self.rows), list(self.own_columns)
        for joint, left in enumerate(residual):
            for periods in _periods(self.rows[joint], left):
                added = []
                for course, moved, trial_rows in zip(self.courses, self.moved, rows[joint], strict=True):
                    turned = periods * moved.q[:, joint]
                    waves = low_passed(
                        np.column_stack([np.sin(turned), np.cos(turned)]), course.step_s, self.cut.hz
                    )
                    waves = decimated(waves, course, self.cut.hz)[trial_rows.moving]
                    added.append(replace(trial_rows, own=np.concatenate([trial_rows.own, waves], axis=1)))
                rows[joint] = tuple(added)
                columns[joint] += tuple(Column("cogging", joint, periods, np.inf, phase) for phase in (0, 1))
        return replace(self, rows=tuple(rows), own_columns=tuple(columns))


def _periods(rows: Sequence[JointRows], residual: Sequence[FloatArray]) -> list[float]:
    """Return the numbers of periods in 2 pi rad that explain most of a residual; none where they explain little."""
    if not sum(len(row.q) for row in rows):
        return []
    q, left = np.concatenate([row.q for row in rows]), np.concatenate(residual)
    travel = 0.5 * float(np.ptp(q))
    grid = (
        np.linspace(_LEAST_PERIODS, _LEAST_PERIODS + 0.25 * np.pi * _SCANNED_PERIODS, _SCANNED_PERIODS)
        / travel
    )
    squares = float(left @ left)
    shares = []
    for periods in grid:
        waves = np.column_stack([np.sin(periods * q), np.cos(periods * q)])
        products = waves.T @ left
        shares.append(float(products @ np.linalg.lstsq(waves.T @ waves, products, rcond=1e-9)[0]) / squares)
    kept: list[float] = []
    for index in np.argsort(shares)[::-1]:
        apart = all(abs(grid[index] - other) * travel > np.pi for other in kept)
        if len(kept) == _PERIODS_KEPT or shares[index] < 1.0 - np.exp(-criteria.MARGIN):
            break
        if apart:
            kept.append(float(grid[index]))
    return kept


def _by_torque(kind: str, factor: float) -> float:
    return factor if kind == "timing" else 1.0


def torque_log(robot: Robot, terms: RobotTerms, dataset: Dataset) -> TorqueLog:
    """Prepare a log in which every drive's torque, or current, is logged beside the joints' angles.

    Parameters
    ----------
    robot, terms
        The robot's file, and what each joint has of its own by it.
    dataset
        Trials with an output for every joint, and with an input for every actuator.
    """
    courses, dead = _courses(robot, terms, dataset)
    names = [joint.name for joint in robot.joints]
    regressor = InertialRegressor(robot.xml, names)
    plant = _Plant(regressor, terms)
    blocks = max(1, -(-criteria.ENOUGH_UNITS // len(courses)))
    cut = choose_cut(courses, plant.classical, blocks)
    moved = [differentiated(course, motion_cut_hz(cut.hz)) for course in courses]
    speed = sign_speeds(courses, moved)
    peak = np.max([np.abs(each.rate).max(axis=0) for each in moved], axis=0)
    tolerance = _tolerance(regressor)
    before = _joints_before(robot)
    rows: list[list[JointRows]] = [[] for _ in names]
    own_columns: list[tuple[Column, ...]] = [()] * len(names)
    for course, moving in zip(courses, moved, strict=True):
        links = regressor.motion(moving.q, moving.rate, moving.acceleration)
        for joint in range(len(names)):
            inertial = regressor.columns(links, joint).reshape(len(moving.q), -1)
            stated = inertial @ regressor.stated.ravel() + plant.passive(moving, joint, speed[joint])
            own = dict(_own(course, moving, joint, before[joint], before, speed, peak, terms, stated))
            own |= {
                Column("tilt", WHOLE, float(axis)): tilt
                for axis, tilt in enumerate(regressor.tilt(links, joint).T)
            }
            values = np.column_stack([*own.values(), stated, course.torque[:, joint], inertial * tolerance])
            passed = decimated(low_passed(values, course.step_s, cut.hz), course, cut.hz)
            length = int(np.ceil(1.0 / (cut.hz * course.step_s)))
            all_moving = moves(moving.rate[:, joint], speed[joint], length)
            is_moving = decimated(all_moving, course, cut.hz)
            if dead[joint] or not peak[joint] > 0.0:
                is_moving = np.zeros_like(is_moving)
            passed, count = passed[is_moving], len(own)
            rows[joint].append(
                JointRows(
                    decimated(course.time_s, course, cut.hz)[is_moving],
                    decimated(moving.q[:, joint], course, cut.hz)[is_moving],
                    passed[:, count + 2 :],
                    passed[:, :count],
                    passed[:, count],
                    passed[:, count + 1],
                    is_moving,
                )
            )
            own_columns[joint] = tuple(own)
    return TorqueLog(
        tuple(names), regressor, tuple(tuple(row) for row in rows), tuple(own_columns),
        tuple(course.label for course in courses), cut, courses[0].step_s, tolerance, speed, peak,
        tuple(courses), tuple(moved), dead, tuple(_currents(robot, dataset)),
        tuple("N m" if joint.unit == "rad" else "N" for joint in robot.joints),
    )  # fmt: skip


def _courses(robot: Robot, terms: RobotTerms, dataset: Dataset) -> tuple[list[Course], tuple[str, ...]]:
    """Return the trials on one time base, and why the torque of a joint says nothing ("" if it does)."""
    outputs = [signal.name for signal in dataset.outputs]
    inputs = [signal.name for signal in dataset.inputs]
    columns = [outputs.index(joint.output) for joint in robot.joints]
    drives = {actuator.joint: actuator for actuator in robot.actuators}
    currents = _currents(robot, dataset)
    step_s = float(np.median(np.concatenate([np.diff(trial.time_s) for trial in dataset.trials])))
    courses, logged = [], []
    for trial in dataset.trials:
        torque = np.zeros((len(trial.time_s), len(columns)))
        for index, joint in enumerate(robot.joints):
            drive = drives.get(joint.name)
            if drive is not None and index in currents:
                torque[:, index] = trial.inputs[:, inputs.index(drive.input)]
            elif drive is not None:
                gains = terms.drives[joint.name]
                torque[:, index] = np.clip(
                    gains.gear * trial.inputs[:, inputs.index(drive.input)], *gains.limits
                )
        logged.append(torque)
        label = str(condition_key(trial.condition)) if trial.condition else trial.label
        courses.append(uniform(label, trial.time_s, trial.outputs[:, columns], torque, step_s))
    every = np.concatenate(logged)
    why = []
    for index, joint in enumerate(robot.joints):
        constant = joint.name in drives and float(np.ptp(every[:, index])) == 0.0
        why.append(f"its torque is {every[0, index]:.3g} throughout" if constant else "")
    return courses, tuple(why)


def _currents(robot: Robot, dataset: Dataset) -> list[int]:
    """Return the places of the joints of which the log states a motor current."""
    in_amperes = {signal.name for signal in dataset.inputs if signal.unit == "A"}
    driven = {actuator.joint for actuator in robot.actuators if actuator.input in in_amperes}
    return [index for index, joint in enumerate(robot.joints) if joint.name in driven]


@dataclass(frozen=True)
class _Plant:
    """What the robot as stated asks of its joints."""

    regressor: InertialRegressor
    terms: RobotTerms

    def passive(self, moving: Moved, joint: int, speed: float) -> FloatArray:
        """Return the torque of the joint's own armature, spring, damping and friction, (n,)."""
        terms = self.terms
        rate = moving.rate[:, joint]
        torque = terms.armature[joint] * moving.acceleration[:, joint] + terms.damping[joint] * rate
        torque = torque + terms.stiffness[joint] * (moving.q[:, joint] - terms.rest[joint])
        return np.asarray(torque + terms.friction[joint] * np.tanh(rate / speed))

    def classical(self, course: Course, moving: Moved) -> FloatArray:
        """Return the stated inertial torque, the other stated torque, friction, offset and logged torque of joints."""
        joints = moving.q.shape[1]
        links = self.regressor.motion(moving.q, moving.rate, moving.acceleration)
        resting = self.regressor.motion(moving.q, moving.rate, np.zeros_like(moving.acceleration))
        whole, still = self.regressor.torque(links, joints), self.regressor.torque(resting, joints)
        made = []
        for joint in range(joints):
            rate = moving.rate[:, joint]
            speed = max(float(np.abs(rate).max()) * 0.01, 1e-12)
            rotor = self.terms.armature[joint] * moving.acceleration[:, joint]
            inertia = whole[:, joint] - still[:, joint] + rotor
            other = still[:, joint] + self.passive(moving, joint, speed) - rotor
            made.append(
                np.column_stack(
                    [inertia, other, np.tanh(rate / speed), rate, np.ones_like(rate), course.torque[:, joint]]
                )
            )
        return np.array(made)


def _tolerance(regressor: InertialRegressor) -> FloatArray:
    """Return how far each inertial parameter may be off: mass, and first and second moments about a typical length."""
    masses, radii = regressor.masses, regressor.radii
    sizes = [np.column_stack([masses] + [masses * radii] * 3 + [masses * radii**2] * 6)]
    return np.asarray(criteria.MASS_TOLERANCE * np.concatenate(sizes).ravel())


def _joints_before(robot: Robot) -> list[int]:
    """Return the place of the joint that carries each joint, `WHOLE` where there is none, in the order of the file."""
    regressor = InertialRegressor(robot.xml, [joint.name for joint in robot.joints])
    return list(regressor.before)


def _own(
    course: Course, moving: Moved, joint: int, before: int, all_before: Sequence[int], speeds: FloatArray,
    peaks: FloatArray, terms: RobotTerms, stated: FloatArray,
) -> Iterator[tuple[Column, FloatArray]]:  # fmt: skip
    """Yield the columns of a joint: see the effects of the same names in the library."""
    q, rate, acceleration = (values[:, joint] for values in (moving.q, moving.rate, moving.acceleration))
    sign = np.tanh(rate / speeds[joint])
    yield (
        Column("timing", WHOLE, 0.0, _TIMING_SAMPLES * course.step_s),
        np.gradient(course.torque[:, joint], course.step_s),
    )
    yield Column("coulomb", joint), sign
    yield Column("viscous", joint), rate
    yield Column("offset", joint), np.ones_like(q)
    yield Column("asymmetry", joint), sign * sign
    yield Column("damping-difference", joint), np.abs(rate)
    yield Column("inertia", joint), acceleration
    if terms.armature[joint]:
        spread = criteria.MASS_TOLERANCE * terms.armature[joint]
        yield Column("armature", joint, 0.0, spread), acceleration
    if terms.damping[joint]:
        yield Column("damping", joint, 0.0, np.inf), rate
    if terms.stiffness[joint]:
        spread = criteria.GAIN_TOLERANCE * terms.stiffness[joint]
        yield Column("spring", joint, 0.0, spread), q - terms.rest[joint]
    yield Column("load", joint), np.abs(stated) * sign
    yield Column("scale", joint), stated
    yield Column("stiffness", joint), q
    for part in STRIBECK_SPEEDS:
        speed = part * peaks[joint]
        if speed > speeds[joint]:
            yield Column("stribeck", joint, speed), sign * np.exp(-np.square(rate / max(speed, 1e-12)))
    for other, way in _coupled_with(joint, before, all_before):
        for coupling in _COUPLINGS:
            motor, pulled = (joint, other) if way > 0 else (other, joint)
            factor = 1.0 if motor == joint else coupling
            turn = moving.acceleration[:, motor] + coupling * moving.acceleration[:, pulled]
            yield Column("coupled-inertia", motor, coupling), factor * turn
            turn = moving.rate[:, motor] + coupling * moving.rate[:, pulled]
            slow = max(float(np.hypot(speeds[motor], speeds[pulled])), 1e-12)
            yield Column("coupled-coulomb", motor, coupling), factor * np.tanh(turn / slow)


def _coupled_with(joint: int, before: int, all_before: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield the joint before (1), whose belt would carry this joint's motor, and those that it carries (-1)."""
    if before != WHOLE:
        yield before, 1
    for other, carrier in enumerate(all_before):
        if carrier == joint:
            yield other, -1


@dataclass(frozen=True)
class Regression:
    """A log as the evidence of linear models.

    Attributes
    ----------
    columns
        Of all joints: links first.
    evidence
        Of the joints that are looked at.
    looked_at
        Their places.
    link_directions : (10 bodies, link columns)
    freed_directions : per body (10, columns)
        From coefficients of columns to inertial parameters, SI.
    independent : (looked at,)
        Independent numbers per row.
    """

    log: TorqueLog
    columns: tuple[Column, ...]
    evidence: LinearEvidence
    looked_at: tuple[int, ...]
    link_directions: FloatArray
    freed_directions: Mapping[int, FloatArray]
    independent: FloatArray

    def residual(self, values: FloatArray) -> list[list[FloatArray]]:
        """Return what coefficients of all columns leave of every row, per joint and trial."""
        return [
            [row.torque - made for row, made in zip(rows, predicted, strict=True)]
            for rows, predicted in zip(self.log.rows, self.predicted(values), strict=True)
        ]

    def predicted(self, values: FloatArray) -> list[list[FloatArray]]:
        """Return the torque that coefficients of all columns make, per joint and trial, (n,)."""
        links = self.deviation(values).ravel() / self.log.tolerance
        numbers = {column: number for number, column in enumerate(self.columns)}
        made = []
        for rows, columns in zip(self.log.rows, self.log.own_columns, strict=True):
            own = np.array([values[numbers[column]] if column in numbers else 0.0 for column in columns])
            made.append([row.stated + row.links @ links + row.own @ own for row in rows])
        return made

    def deviation(self, values: FloatArray, freed: Collection[int] | None = None) -> FloatArray:
        """Return how far inertial parameters are from what is stated, (bodies, 10).

        Parameters
        ----------
        freed
            Bodies whose loads count; where given, nothing else does.
        """
        total = np.zeros(len(self.log.tolerance))
        if freed is None:
            total += self.link_directions @ values[self.columns_of("link")]
        for body, directions in self.freed_directions.items():
            if freed is None or body in freed:
                total += directions @ values[self.columns_of("freed", None, float(body))]
        return total.reshape(-1, 10)

    def columns_of(self, kind: str, joint: int | None = None, detail: float | None = None) -> IntArray:
        """Return the places of columns of a kind."""
        return np.array(
            [
                index
                for index, column in enumerate(self.columns)
                if column.kind == kind
                and (joint is None or column.joint == joint)
                and (detail is None or column.detail == detail)
            ],
            dtype=np.int64,
        )

    def acting(self, joint_index: int) -> set[int]:
        """Return at which of the looked-at joints (by their number there) a column acts."""
        return {number for number, gram in enumerate(self.evidence.grams) if joint_index in gram.columns}


def regression(log: TorqueLog) -> Regression:
    """Cut a log into units of evidence, reduce the links to what is seen of them, and sum up everything.

    A unit is a condition, or where these are few, a block of time longer than the correlation time of what
    recalibration leaves.
    """
    looked_at = tuple(
        joint for joint, rows in enumerate(log.rows) if sum(len(row.torque) for row in rows) > 0
    )
    own = tuple(dict.fromkeys(column for joint in looked_at for column in log.own_columns[joint]))
    bodies = len(log.regressor.bodies)
    links = [Column("raw", WHOLE, float(number), 1.0) for number in range(10 * bodies)]
    raw = (*links, *own)
    numbers = {column: number for number, column in enumerate(raw)}
    units, strata = _units(log, looked_at)
    grams = []
    for joint in looked_at:
        columns = np.array([*range(10 * bodies), *(numbers[column] for column in log.own_columns[joint])])
        rows = [
            [np.concatenate([row.links, row.own], axis=1), row.torque - row.stated] for row in log.rows[joint]
        ]
        parts: list[list[list[FloatArray]]] = [[[], []] for _ in strata]
        for trial, (values, excess) in enumerate(rows):
            moving = log.rows[joint][trial].moving
            for unit in np.unique(units[trial]):
                chosen = units[trial][moving] == unit
                parts[unit][0].append(values[chosen])
                parts[unit][1].append(excess[chosen])
        grams.append(
            Gram.of(
                columns,
                [np.concatenate(part[0]) for part in parts],
                [np.concatenate(part[1]) for part in parts],
            )
        )
    precision = np.array([1.0 / np.square(column.spread) for column in raw])
    evidence = LinearEvidence(tuple(grams), strata, precision, np.ones(len(grams)))
    return _reduced(log, raw, evidence, looked_at, _independent(log, looked_at))


def _independent(log: TorqueLog, looked_at: Sequence[int]) -> FloatArray:
    shares = []
    for joint in looked_at:
        others = [index for index, column in enumerate(log.own_columns[joint]) if column.kind in _CLASSICAL]
        lengths = [
            correlation_samples(_recalibrated(row, others)[:, None])
            for row in log.rows[joint]
            if len(row.torque) > 2
        ]
        shares.append(1.0 / max(float(np.median(lengths)) if lengths else 1.0, 1.0))
    return np.array(shares)


def _recalibrated(rows: JointRows, others: Sequence[int] = ()) -> FloatArray:
    """Return what a joint's own recalibration, and free columns beside it, leave of one trial, (n,)."""
    excess = rows.torque - rows.stated
    columns = np.concatenate([rows.links, rows.own[:, list(others)]], axis=1)
    prior = np.concatenate([np.ones(rows.links.shape[1]), np.full(len(others), 1e-12)])
    variance = max(float(np.var(excess)), 1e-300)
    values = np.linalg.lstsq(
        columns.T @ columns / variance + np.diag(prior), columns.T @ excess / variance, rcond=1e-12
    )[0]
    return np.asarray(excess - columns @ values)


def _units(log: TorqueLog, looked_at: Sequence[int]) -> tuple[list[IntArray], IntArray]:
    """Return the unit of every row of each trial, and the condition of each unit."""
    conditions = list(dict.fromkeys(log.conditions))
    wanted = 1 if len(conditions) >= criteria.ENOUGH_UNITS else -(-criteria.ENOUGH_UNITS // len(conditions))
    lengths = [len(log.rows[0][trial].moving) for trial in range(len(log.conditions))]
    longest = [
        max(
            (
                correlation_samples(_recalibrated(log.rows[joint][trial])[:, None])
                for joint in looked_at
                if len(log.rows[joint][trial].torque) > 2
            ),
            default=1.0,
        )
        for trial in range(len(lengths))
    ]
    first, strata, units = 0, list[int](), [np.zeros(length, dtype=np.int64) for length in lengths]
    for number, condition in enumerate(conditions):
        trials = [trial for trial, label in enumerate(log.conditions) if label == condition]
        blocks = min(wanted, max(1, min(int(lengths[trial] / longest[trial]) for trial in trials)))
        if len(conditions) == 1:
            blocks = max(blocks, 2)
        for trial in trials:
            units[trial] = first + (np.arange(lengths[trial]) * blocks // lengths[trial])
        strata += [number] * blocks
        first += blocks
    return units, np.array(strata)


def _reduced(
    log: TorqueLog,
    raw: Sequence[Column],
    evidence: LinearEvidence,
    looked_at: tuple[int, ...],
    independent: FloatArray,
) -> Regression:
    """Replace the inertial parameters by the combinations that the motion shows (base parameters).

    In units of what is stated of them, the combinations are the eigenvectors of the information that the data hold;
    those that are not seen stay as stated (Gautier, J. Robotic Systems 8 (1991) 485, with priors).
    """
    count = 10 * len(log.regressor.bodies)
    variance = np.array([gram.torque.sum() / max(gram.count.sum(), 1.0) for gram in evidence.grams])
    weighed = replace(evidence, weights=independent / np.maximum(variance, 1e-300))
    information = weighed.normal(np.ones(evidence.units))[0][:count, :count]
    link = _seen(information)
    freed = {}
    total = float(log.regressor.masses.sum())
    radius = float(log.regressor.radii.max())
    for body in range(len(log.regressor.bodies)):
        rows = slice(10 * body, 10 * body + 10)
        free = total * np.array([1.0] + [radius] * 3 + [_LOAD_INERTIA * radius**2] * 6) / log.tolerance[rows]
        directions = np.zeros((count, 10))
        directions[rows] = np.diag(free)
        freed[body] = directions @ _seen(directions.T @ information @ directions)
    transform = np.concatenate([link, *freed.values()], axis=1)
    own = raw[count:]
    columns = [Column("link", WHOLE, float(number), 1.0) for number in range(link.shape[1])]
    for body, directions in freed.items():
        columns += [Column("freed", WHOLE, float(body), 1.0) for _ in range(directions.shape[1])]
    made, width = [], transform.shape[1]
    for gram in evidence.grams:
        size = len(gram.columns)
        whole = np.zeros((size, width + size - count))
        whole[:count, :width], whole[count:, width:] = transform, np.eye(size - count)
        made.append(
            replace(
                gram,
                columns=np.concatenate([np.arange(width), gram.columns[count:] - count + width]),
                squares=np.einsum("ka,ukl,lb->uab", whole, gram.squares, whole, optimize=True),
                products=gram.products @ whole,
            )
        )
    every = (*columns, *own)
    precision = np.array([1.0 / np.square(column.spread) for column in every])
    return Regression(
        log, every, LinearEvidence(tuple(made), evidence.strata, precision, weighed.weights), looked_at,
        log.tolerance[:, None] * link, {body: log.tolerance[:, None] * torque for body, torque in freed.items()},
            independent,
    )  # fmt: skip


def _seen(information: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors[:, values > _SEEN])
