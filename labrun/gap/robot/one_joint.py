"""One joint as a model of its own: its drive and what it carries, while the others move as they were measured.

The joint's equation is the row of the robot's equations of motion that belongs to it (Featherstone, Rigid Body Dynamics
Algorithms (2008), chapter 3), linearised about the measured motion in what the joint itself does:

    (armature + H(t)) q'' = drive - damping q' - c(t) - dc/dq (q - q_measured) - dc/dq' (q' - q'_measured)

H and c come from the inverse dynamics of the bodies that hang on the joint, each in proportion to its mass.

Where the log holds the torque itself, the same equation is read the other way: which torque the measured motion asks
for, beside the one that was exerted. Integrated, a joint that no servo holds drifts away from whatever was measured,
and every small constant in its torque is all there is to see.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, load_effect
from labrun.errors import RequestError
from labrun.fit import Dataset
from labrun.gap import criteria
from labrun.gap.motion import smoothed
from labrun.models import (
    Carried,
    Model,
    Robot,
    RobotActuator,
    RobotJoint,
    RobotTerms,
    TipLoad,
    carried,
    identifier,
    parse_model,
    robot_terms,
)
from labrun.store import SignalInfo


@dataclass(frozen=True)
class OneJoint:
    """A joint with its model, its data, and the model's text with the clock of the log."""

    joint: RobotJoint
    model: Model
    dataset: Dataset
    text: str = ""

    @property
    def by_torque(self) -> bool:
        """Tell whether its output is the torque that it was driven by, not its angle."""
        return not self.model.states


@dataclass(frozen=True)
class Prescribed:
    """A robot's log with the motion and the torques that it shows.

    Attributes
    ----------
    motions
        Of every trial: coordinates, rates and accelerations of all joints.
    terms
        Of every trial: what the joints carry.
    around
        Of every trial, (n, joints): what a tilted base and a load ask of the joints more, and what a controller that
        holds weights asks less, where these are known.
    lead_s
        By how much all goals are stamped late beside all angles, where that is known; negative if angles follow late.
    links
        Of every trial, (n, joints): how far joints are from what was measured of them, where that is known.
    """

    robot: Robot
    whole: Model
    dataset: Dataset
    motions: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]
    terms: tuple[Carried, ...]
    own: RobotTerms
    around: tuple[FloatArray, ...] = ()
    lead_s: float = 0.0
    links: tuple[FloatArray, ...] = ()

    @property
    def sample_s(self) -> float:
        """The usual time between samples."""
        return float(np.median(np.concatenate([np.diff(trial.time_s) for trial in self.dataset.trials])))

    def late_s(self, channel: str) -> float:
        """Return by how much an input acts late on the whole: half a sample where it is held from one to the next."""
        between = next(signal.between for signal in self.dataset.inputs if signal.name == channel)
        return 0.5 * self.sample_s if between == "hold" else 0.0

    def led(self, lead_s: float) -> "Prescribed":
        """Return the same with goals that are stamped late by so much."""
        return replace(self, lead_s=lead_s)

    @property
    def clock(self) -> str:
        """What goals of that time are called in the library; "" if there is none."""
        return "" if not self.lead_s else "late-clock" if self.lead_s > 0.0 else "delay"

    def clock_at(self, channel: str) -> AttachedEffect:
        """Return the effect of the log's clock at the goal of a joint."""
        return AttachedEffect(load_effect(self.clock, "input"), channel, (abs(self.lead_s),))

    def drive(self, joint: RobotJoint) -> RobotActuator | None:
        """Return what drives a joint."""
        return next((actuator for actuator in self.robot.actuators if actuator.joint == joint.name), None)

    def torque_of(self, joint: RobotJoint) -> RobotActuator | None:
        """Return what drives a joint if the log holds its torque as it was exerted; None otherwise."""
        drive = self.drive(joint)
        if drive is None or drive.command not in ("torque", "geared"):
            return None
        column = [signal.name for signal in self.dataset.inputs].index(drive.input)
        logged = np.concatenate([trial.inputs[:, column] for trial in self.dataset.trials])
        gains = self.own.drives[joint.name]
        low, high = np.sort(np.array(gains.limits) / gains.gear) if gains.gear else (0.0, 0.0)
        return drive if low < logged.min() and logged.max() < high else None

    def on_base(self, roll: float, pitch: float) -> "Prescribed":
        """Return the same with a base that is tilted by these angles (rad)."""
        tilted = tuple(roll * term.tilt[:, :, 0] + pitch * term.tilt[:, :, 1] for term in self.terms)
        return replace(self, around=tilted)

    def held(self, share: float) -> "Prescribed":
        """Return the same with a controller that holds a share of all weights."""
        before = self.around or tuple(np.zeros_like(term.load) for term in self.terms)
        less = tuple(was - share * term.gravity for was, term in zip(before, self.terms, strict=True))
        return replace(self, around=less)

    def loaded(self, mass_kg: float) -> "Prescribed":
        """Return the same with a load where one is looked for."""
        before = self.around or tuple(np.zeros_like(term.load) for term in self.terms)
        more = tuple(was + mass_kg * term.load for was, term in zip(before, self.terms, strict=True))
        return replace(self, around=more)

    def carried(self, number: int, joint_index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what a joint carries in a trial, without noise, and its first two derivatives."""
        terms, (_, _, acceleration) = self.terms[number], self.motions[number]
        torque = terms.torque[:, joint_index] + terms.inertia[:, joint_index] * acceleration[:, [joint_index]]
        return smoothed(self.dataset.trials[number].time_s, torque.sum(axis=1, keepdims=True))

    def given_way(self, number: int, joint_index: int) -> FloatArray:
        """Return what a drive exerts less for each rad (m) that the link gives way by each N m (N) it carries.

        The link, and what hangs on it, is then not where the encoder of the motor is: to first order, inertia and
        slopes of the equations of motion times what it carries tell how much that is.
        """
        terms = self.terms[number]
        torque, first, second = (course[:, 0] for course in self.carried(number, joint_index))
        inertia = terms.inertia[:, joint_index].sum(axis=1)
        less: FloatArray = (
            inertia * second + terms.slope[:, joint_index] * torque + terms.rate_slope[:, joint_index] * first
        )
        return less

    @property
    def tip(self) -> TipLoad:
        """A kilogram on the last body along the whole log."""
        q, rate, acceleration = (np.concatenate([motion[k] for motion in self.motions]) for k in range(3))
        return TipLoad(self.robot.xml, [joint.name for joint in self.robot.joints], (q, rate, acceleration))

    def with_load_at(self, torque: FloatArray) -> "Prescribed":
        """Return the same with a load looked for where a kilogram asks this of the joints, (all samples, joints)."""
        parts = np.split(torque, np.cumsum([len(term.load) for term in self.terms])[:-1])
        terms = tuple(replace(term, load=part) for term, part in zip(self.terms, parts, strict=True))
        return replace(self, terms=terms)

    def with_links(self, deviations: Mapping[int, Sequence[FloatArray]]) -> "Prescribed":
        """Return the same with joints that stand beside what was measured of them, by place and trial, by so much."""
        if not deviations:
            return self
        links = [np.zeros((len(trial.time_s), len(self.robot.joints))) for trial in self.dataset.trials]
        for joint_index, courses in deviations.items():
            for of_trial, course in zip(links, courses, strict=True):
                of_trial[:, joint_index] = course
        pairs = zip(self.dataset.trials, links, strict=True)
        moved = self._measured([trial.outputs[:, self._columns] + by for trial, by in pairs])
        return replace(moved, around=(), links=tuple(links))

    def redrawn(self, rng: np.random.Generator) -> "Prescribed":
        """Return what would be prescribed if this motion were the true one, measured again with the same noise."""
        measured = [trial.outputs[:, self._columns] for trial in self.dataset.trials]
        if self.links:
            measured = [angle + by for angle, by in zip(measured, self.links, strict=True)]
        smooth = [q for q, _, _ in self.motions]
        left = np.concatenate(measured) - np.concatenate(smooth)
        noise = np.sqrt(np.mean(np.square(left), axis=0))
        return self._measured([q + noise * rng.standard_normal(q.shape) for q in smooth])

    @property
    def _columns(self) -> list[int]:
        names = [output.name for output in self.dataset.outputs]
        return [names.index(joint.output) for joint in self.robot.joints]

    def _measured(self, angles: Sequence[FloatArray]) -> "Prescribed":
        """Return the same with motion and torques of these angles, (n, joints) of every trial, and the log as it is."""
        trials = []
        for trial, angle in zip(self.dataset.trials, angles, strict=True):
            outputs = trial.outputs.copy()
            outputs[:, self._columns] = angle
            trials.append(replace(trial, outputs=outputs))
        made = prescribed(self.robot, self.whole, replace(self.dataset, trials=tuple(trials)))
        return replace(self, motions=made.motions, terms=made.terms)


def why_not(robot: Robot, dataset: Dataset) -> str:
    """Return why a robot cannot be taken apart into its joints; "" if it can."""
    measured = {output.name for output in dataset.outputs}
    missing = [joint.name for joint in robot.joints if joint.output not in measured]
    if missing:
        return f"the log has no angle of {', '.join(missing)}"
    coupled = robot_terms(robot.xml, [joint.name for joint in robot.joints]).coupled
    if coupled:
        return coupled
    for actuator in robot.actuators:
        if not actuator.joint or actuator.command == "other":
            return f"actuator {actuator.name} drives no joint by a goal or a torque"
    names = [actuator.joint for actuator in robot.actuators]
    twice = sorted({name for name in names if names.count(name) > 1})
    return f"more than one actuator drives {', '.join(twice)}" if twice else ""


def prescribed(robot: Robot, whole: Model, dataset: Dataset) -> Prescribed:
    """Find the motion of all joints and what each carries.

    Parameters
    ----------
    whole
        The model of the whole robot, whose statements of gains, springs and damping count.

    Raises
    ------
    RequestError
        The robot cannot be taken apart into its joints, with the reason.
    """
    reason = why_not(robot, dataset)
    if reason:
        raise RequestError(f"{robot.name} cannot be looked at joint by joint: {reason}")
    names = [output.name for output in dataset.outputs]
    columns = [names.index(joint.output) for joint in robot.joints]
    motions = [smoothed(trial.time_s, trial.outputs[:, columns]) for trial in dataset.trials]
    joints = [joint.name for joint in robot.joints]
    lengths = [len(motion[0]) for motion in motions]
    moved = tuple(np.concatenate([motion[k] for motion in motions]) for k in range(3))
    terms = carried(robot.xml, joints, moved)  # type: ignore[arg-type]
    return Prescribed(
        robot, whole, dataset, tuple(motions), tuple(_parts(terms, lengths)), robot_terms(robot.xml, joints)
    )


def _parts(terms: Carried, lengths: Sequence[int]) -> Iterator[Carried]:
    first = 0
    for length in lengths:
        rows = slice(first, first + length)
        yield Carried(
            terms.bodies, terms.inertia[rows], terms.torque[rows], terms.slope[rows], terms.rate_slope[rows],
            terms.tilt[rows], terms.load[rows], terms.gravity[rows],
        )  # fmt: skip
        first += length


def one_joint(dynamics: Prescribed, index: int) -> OneJoint:
    """Return the model of a joint, and the trials as it sees them."""
    joint = dynamics.robot.joints[index]
    drive = dynamics.drive(joint)
    torque = np.concatenate([term.torque[:, index] for term in dynamics.terms])
    inertia = np.concatenate([term.inertia[:, index] for term in dynamics.terms])
    acceleration = np.concatenate([motion[2][:, index] for motion in dynamics.motions])
    shares = np.sqrt(np.mean((torque + inertia * acceleration[:, None]) ** 2, axis=0))
    total = float(np.sqrt(np.mean(np.sum(torque + inertia * acceleration[:, None], axis=1) ** 2)))
    own = [k for k, share in enumerate(shares) if share > criteria.LEAST_TORQUE * total]
    rest = [k for k in range(len(shares)) if k not in own]
    tilted = bool(
        max(float(np.ptp(term.tilt[:, index])) for term in dynamics.terms) > criteria.LEAST_TORQUE * total
    )
    loaded = bool(max(float(np.ptp(term.load[:, index])) for term in dynamics.terms) > 0)
    bodies = [dynamics.terms[0].bodies[k] for k in own]
    text = "\n".join(_lines(dynamics, index, joint, drive, bodies, tilted=tilted, loaded=loaded))
    model = parse_model(text, f"{dynamics.robot.name}: {joint.name}")
    if drive is not None and dynamics.lead_s and model.states:
        model = model.with_effects([dynamics.clock_at(drive.input)])
    dataset = _dataset(dynamics, index, joint, drive, own, rest, model, tilted=tilted, loaded=loaded)
    return OneJoint(joint, model, dataset, f"{text}\n# {dynamics.clock} {dynamics.lead_s!r}")


def _dataset(
    dynamics: Prescribed, joint_index: int, joint: RobotJoint, drive: RobotActuator | None,
    own: list[int], rest: list[int],
    model: Model, *, tilted: bool, loaded: bool,
) -> Dataset:  # fmt: skip
    data = dynamics.dataset
    output = [port.name for port in data.outputs].index(joint.output)
    goal = [signal.name for signal in data.inputs].index(drive.input) if drive else None
    by_torque = not model.states
    trials, start_s = [], 0.0
    conditions = [tuple(sorted(trial.condition.items())) for trial in data.trials]
    in_row = len(set(conditions)) == len(conditions)
    around = dynamics.around or tuple(np.zeros_like(q) for q, _, _ in dynamics.motions)
    every = zip(data.trials, dynamics.motions, dynamics.terms, around, strict=True)
    for number, (trial, (q, rate, acceleration), terms, more) in enumerate(every):
        columns = [] if goal is None or by_torque else [trial.inputs[:, goal]]
        columns += [terms.torque[:, joint_index, k] for k in own] + [
            terms.inertia[:, joint_index, k] for k in own
        ]
        columns += [
            terms.torque[:, joint_index, rest].sum(axis=1) + more[:, joint_index],
                terms.inertia[:, joint_index, rest].sum(axis=1),
            terms.slope[:, joint_index], terms.rate_slope[:, joint_index], q[:, joint_index], rate[:, joint_index],
            dynamics.given_way(number, joint_index), terms.gravity[:, joint_index],
                dynamics.carried(number, joint_index)[0][:, 0],
        ]  # fmt: skip
        columns += [acceleration[:, joint_index]] if by_torque else []
        columns += [terms.tilt[:, joint_index, 0], terms.tilt[:, joint_index, 1]] if tilted else []
        columns += [terms.load[:, joint_index]] if loaded else []
        # trials of one log follow one another: what changes with the log's time needs it (repeats are averaged instead)
        time_s = trial.time_s + (start_s - trial.time_s[0]) if in_row else trial.time_s
        start_s += float(trial.time_s[-1] - trial.time_s[0])
        outputs = trial.outputs[:, [output]].copy()
        if drive is not None and by_torque:
            at_s = trial.time_s + dynamics.lead_s - dynamics.late_s(drive.input)
            outputs[:, 0] = np.interp(at_s, trial.time_s, trial.inputs[:, goal])
        trials.append(replace(trial, time_s=time_s, inputs=np.column_stack(columns), outputs=outputs))
    known = {signal.name: signal for signal in data.inputs}
    infos = tuple(known.get(signal.name) or SignalInfo(signal.name, signal.unit) for signal in model.inputs)
    return replace(
        data,
        name=f"{data.name}: {joint.name}",
        inputs=infos,
        outputs=(
            SignalInfo(model.outputs[0].name, model.outputs[0].unit) if by_torque else data.outputs[output],
        ),
        trials=tuple(trials),
    )


def _lines(
    dynamics: Prescribed, joint_index: int, joint: RobotJoint, drive: RobotActuator | None, bodies: list[str],
    *, tilted: bool, loaded: bool,
) -> Iterator[str]:  # fmt: skip
    q, rate = joint.output, f"{joint.output}_rate"
    by_torque = dynamics.torque_of(joint) is not None
    yield f'name = "{dynamics.robot.name}-{joint.output}"'
    yield "states = []" if by_torque else f'states = ["{q}", "{rate}"]'
    yield "[inputs]"
    if drive is not None and not by_torque:
        between = "hold" if drive.command in ("position", "velocity") else "linear"
        yield f'{drive.input} = {{ unit = "{drive.unit}", between = "{between}" }}'
    known = [f"torque_{k}" for k in range(len(bodies))] + [f"inertia_{k}" for k in range(len(bodies))]
    known += ["torque_rest", "inertia_rest", "slope", "rate_slope", "measured", "measured_rate", "given_way"]
    known += ["weight_torque", "motion_torque"]
    known += ["measured_acceleration"] if by_torque else []
    known += ["roll_torque", "pitch_torque"] if tilted else []
    known += ["load_torque"] if loaded else []
    for name in known:
        yield f'{name} = {{ prescribed = true, between = "linear" }}'
    yield "[parameters]"
    yield from _parameters(dynamics, joint_index, joint, drive, bodies)
    masses = [f"{identifier(body)}_mass_ratio" for body in bodies]
    torque = " + ".join(["torque_rest", *(f"{mass}*torque_{k}" for k, mass in enumerate(masses))])
    inertia = " + ".join(
        [f"{q}_armature", "inertia_rest", *(f"{mass}*inertia_{k}" for k, mass in enumerate(masses))]
    )
    effort = _effort(joint, drive, dynamics)
    angle, speed = ("measured", "measured_rate") if by_torque else (q, rate)
    own = [f"{q}_damping*{speed}"]
    if joint.sprung:
        own.append(f"{q}_stiffness*({angle} - {dynamics.own.rest[joint_index]!r})")
    if dynamics.own.friction[joint_index]:
        own.append(f"{dynamics.own.friction[joint_index]!r}*tanh({speed}/0.01)")
    forces = [
        f"force.{q}",
        f"force.{q}_link",
        *([f"force.{q}_controller"] if drive is not None else []),
        *([f"force.{_whole_site('base', joint)}"] if tilted else []),
        *([f"force.{_whole_site('tip', joint)}"] if loaded else []),
    ]
    yield "[equations]"
    if by_torque and drive is not None:
        asked = f"({inertia})*measured_acceleration + {' + '.join(own)} + ({torque})"
        gear = dynamics.own.drives[joint.name].gear
        yield "[outputs]"
        yield f'{drive.input} = {{ equation = "({asked} - {" - ".join(forces)})/{gear!r}", unit = "{drive.unit}" }}'
        yield from _sites(joint, asked, (angle, speed), driven=True, tilted=tilted, loaded=loaded)
        return
    yield f'{q} = "{rate}"'
    yield (
        f'{rate} = "({effort} + {" + ".join(forces)} - {" - ".join(own)} - ({torque}) - slope*({q} - measured)'
        f' - rate_slope*({rate} - measured_rate)) / ({inertia})"'
    )
    yield "[outputs]"
    yield f'{q} = {{ equation = "{q}", unit = "{joint.unit}" }}'
    yield from _sites(joint, effort, (q, rate), driven=drive is not None, tilted=tilted, loaded=loaded)
    yield "[initial]"
    yield f'{q} = "first"\n{rate} = "free"'


def _parameters(
    dynamics: Prescribed, joint_index: int, joint: RobotJoint, drive: RobotActuator | None, bodies: list[str]
) -> Iterator[str]:
    q = joint.output
    force, per = ("N m", "N m s/rad") if joint.unit == "rad" else ("N", "N s/m")
    yield _parameter(dynamics.whole, f"{q}_damping", dynamics.own.damping[joint_index], "free", per)
    if joint.sprung:
        yield _parameter(
            dynamics.whole,
            f"{q}_stiffness",
            dynamics.own.stiffness[joint_index],
            criteria.GAIN_TOLERANCE,
            f"{force}/{joint.unit}",
        )
    armature = dynamics.own.armature[joint_index]
    if armature or f"{q}_armature" in {parameter.name for parameter in dynamics.whole.parameters}:
        # a rotor's inertia behind a gear is known no better than the masses that hang on the joint
        inertia = "kg m^2" if joint.unit == "rad" else "kg"
        yield _parameter(dynamics.whole, f"{q}_armature", armature, criteria.MASS_TOLERANCE, inertia)
    else:
        yield f"{q}_armature = {{ value = 0.0, tolerance = 0.0 }}"
    gains = dynamics.own.drives.get(joint.name)
    if gains is not None and gains.kp:
        yield _parameter(
            dynamics.whole, _gain(joint, drive), gains.kp, criteria.GAIN_TOLERANCE, f"{force}/{joint.unit}"
        )
    if gains is not None and gains.kv and drive is not None and drive.command == "position":
        # of the motion alone it is the joint's damping; of what the drive puts on the gear it is a part
        yield _parameter(dynamics.whole, _rate_gain(joint, drive), gains.kv, criteria.GAIN_TOLERANCE, per)
    for k, body in enumerate(bodies):
        known = f"value = 1.0, tolerance = {criteria.MASS_TOLERANCE}, lower = 0.0"
        yield f"{identifier(body)}_mass_ratio = {{ {known} }} # {k}"


def _sites(
    joint: RobotJoint, effort: str, motion: tuple[str, str], *, driven: bool, tilted: bool, loaded: bool
) -> Iterator[str]:
    """Return the lines of a joint's sites.

    Parameters
    ----------
    effort
        Equation of what its drive puts on it.
    motion
        What of the model its angle and its rate are.
    """
    q, (angle, rate) = joint.output, motion
    yield f"[sites.{q}]"
    yield f'kind = "joint"\ncoordinate = "{angle}"\nrate = "{rate}"\nload = "{effort}"'
    if driven:
        yield "drive = true"
    if joint.sprung:
        yield f'stiffness = "{q}_stiffness"'
    yield f'[sites.{q}_link]\nkind = "link"\ncoordinate = "given_way"\nrate = "{rate}"\nunit = "{joint.unit}"'
    if driven:
        yield f'[sites.{q}_controller]\nkind = "controller"\ncoordinate = "weight_torque"\nrate = "motion_torque"'
    if tilted:
        yield f"[sites.{_whole_site('base', joint)}]"
        yield 'kind = "base"\ncoordinate = "roll_torque"\nrate = "pitch_torque"'
    if loaded:
        yield f"[sites.{_whole_site('tip', joint)}]"
        yield 'kind = "tip"\ncoordinate = "load_torque"\nrate = "load_torque"'


def _whole_site(kind: str, joint: RobotJoint) -> str:
    """Return what the site of the robot as a whole is called: its kind, unless the joint itself is called that."""
    return f"robot_{kind}" if joint.output == kind else kind


def _gain(joint: RobotJoint, drive: RobotActuator | None) -> str:
    """Return what the gain is called in the model of the whole robot."""
    return f"{joint.output if drive is None else identifier(drive.name)}_kp"


def _rate_gain(joint: RobotJoint, drive: RobotActuator | None) -> str:
    return f"{joint.output if drive is None else identifier(drive.name)}_kv"


def _effort(joint: RobotJoint, drive: RobotActuator | None, dynamics: Prescribed) -> str:
    """Return the equation of what the drive puts on the joint."""
    if drive is None:
        return "0.0"
    gains_name = _gain(joint, drive)
    gains = dynamics.own.drives[joint.name]
    q, rate = joint.output, f"{joint.output}_rate"
    if drive.command in ("torque", "geared"):
        effort = f"{gains.gear!r}*{drive.input}"
    elif drive.command == "velocity":
        effort = f"{gains_name}*({drive.input} - {rate})"
    else:
        effort = f"{gains_name}*({drive.input} - {q})"
        effort += f" - {_rate_gain(joint, drive)}*{rate}" if gains.kv else ""
    low, high = gains.limits
    return f"clip({effort}, {low!r}, {high!r})" if np.isfinite([low, high]).all() else effort


def _parameter(whole: Model, name: str, value: float, tolerance: float | str, unit: str) -> str:
    """Return the line of a parameter: what the model of the whole robot says of it, where it has one of that name."""
    known = next((parameter for parameter in whole.parameters if parameter.name == name), None)
    if known is not None:
        value, tolerance = known.value, known.tolerance
    text = f'"{tolerance}"' if isinstance(tolerance, str) else repr(float(tolerance))
    return f'{name} = {{ value = {value!r}, tolerance = {text}, unit = "{unit}", lower = 0.0 }}'
