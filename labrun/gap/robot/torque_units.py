"""What unit and sign the logged torque of each joint has: torques, motor currents, or one with the opposite sign."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Dataset
from labrun.gap import criteria, decide
from labrun.gap.robot.linear_evidence import LinearEvidence, jackknife_error, log_errors, units_of
from labrun.gap.robot.torque_columns import NUISANCE, Regression, TorqueLog

_FRICTION = ("coulomb", "viscous", "offset")
_REWEIGHED = 3
"""Fits from which a joint's weight does not change any more."""


@dataclass(frozen=True)
class LoggedUnits:
    """How logged torques become those that act on the joints.

    Attributes
    ----------
    factors : (joints,)
        What each is multiplied by.
    unknown
        Joints whose factor is an estimate, so that their scale is fitted beside everything else.
    remarks
        What to know of it, in sentences.
    per_ampere
        Joints of which the log states a motor current that shows the torque per ampere: place, name, and unit of the
        torque.
    """

    factors: FloatArray
    unknown: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    per_ampere: tuple[tuple[int, str, str], ...] = ()

    @property
    def as_logged(self) -> bool:
        """Tell whether the log is taken as it is."""
        return bool(np.all(self.factors == 1.0)) and not self.unknown

    def unit(self, log: TorqueLog, joint: int) -> str:
        """Return the unit of a joint's torque as it is read: amperes where the log does not show what one is."""
        shown = {index for index, _, _ in self.per_ampere}
        return "A" if joint in log.currents and joint not in shown else log.torque_units[joint]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The torque per ampere of motor currents, and what else to know."""
        provided = "if the stated masses are right"
        constants = [
            (name, f"{abs(self.factors[joint]):.3g} {unit}/A") for joint, name, unit in self.per_ampere
        ]
        if not constants:
            return self.remarks
        if len(constants) == 1:
            ((name, constant),) = constants
            first = f"the torque of joint {name} is a motor current: {constant}, {provided}"
        else:
            listed = ", ".join(f"{name} {constant}" for name, constant in constants)
            first = f"the torques are motor currents: {listed}, {provided}"
        return (first, *self.remarks)


def in_torques(dataset: Dataset, diagnosis: Mapping[str, Any]) -> Dataset:
    """Return a log whose inputs are torques of the model's unit and sign, as a diagnosis reads them.

    Parameters
    ----------
    diagnosis
        As `RobotDiagnosis.to_json` gives it.
    """
    factors = diagnosis.get("input_factors", {})
    if not factors:
        return dataset
    scale = np.array([factors.get(signal.name, 1.0) for signal in dataset.inputs])
    trials = tuple(replace(trial, inputs=trial.inputs * scale) for trial in dataset.trials)
    return replace(dataset, trials=trials)


def logged_units(data: Regression, currents: Sequence[int] = ()) -> LoggedUnits:
    """Find scale and sign of each joint's logged torque.

    Of a motor current the scale is always fitted. Of a torque it is asked for where no mass within its tolerance and no
    load explain it. The stated links are what scales are told by; friction of any size stands beside them.

    Parameters
    ----------
    currents
        Places of the joints of which the log states a motor current.
    """
    of_currents, of_torques = _of_currents(data, currents), _of_torques(data, currents)
    return LoggedUnits(
        of_currents.factors * of_torques.factors,
        (*of_currents.unknown, *of_torques.unknown),
        (*of_currents.remarks, *of_torques.remarks),
        of_currents.per_ampere,
    )


def refined(units: LoggedUnits, data: Regression) -> LoggedUnits:
    """Return units whose estimated factors are fitted again where every joint counts in units of what is left of it.

    Parameters
    ----------
    data
        With the torques as `units` has them.
    """
    joints = [joint for joint in units.unknown if units.factors[joint] != 1.0]
    if not joints:
        return units
    scales = _scale_places(data, joints)
    active = np.sort(np.concatenate([_beside_scales(data), _scale_places(data, units.unknown)]))
    evidence = data.evidence
    for _ in range(_REWEIGHED):
        evidence = evidence.reweighed(evidence.unseen(active), data.independent)
    factors = units.factors.copy()
    factors[joints] /= 1.0 + evidence.fit(active)[scales]
    return replace(units, factors=factors)


def _of_currents(data: Regression, currents: Sequence[int]) -> LoggedUnits:
    """Return the torque per ampere of the joints of which the log states a motor current."""
    factors, names = np.ones(len(data.log.joints)), data.log.joints
    joints = [joint for joint in data.looked_at if joint in currents]
    if not joints:
        return LoggedUnits(factors)
    nuisances, scales = _beside_scales(data), _scale_places(data, joints)
    evidence = _cautious(data)
    every = list(range(len(data.looked_at)))
    ((_, left_out),) = evidence.unseen_with(nuisances, [scales], [every])
    gains, errors = 1.0 + left_out.mean(axis=0), [jackknife_error(values) for values in left_out.T]
    shown, flipped, hidden = list[tuple[int, str, str]](), list[str](), list[str]()
    for joint, gain, error in zip(joints, gains, errors, strict=True):
        if abs(gain) <= criteria.WITHIN_TOLERANCES * error:
            hidden.append(names[joint])
            continue
        factors[joint] = 1.0 / gain
        shown.append((joint, names[joint], data.log.torque_units[joint]))
        if gain < 0.0:
            flipped.append(names[joint])
    remarks = [_opposite(name) for name in flipped]
    if hidden:
        remarks.append(
            f"{', '.join(hidden)}: the log does not show the torque per ampere; sizes there are in amperes"
        )
    return LoggedUnits(factors, tuple(joints), tuple(remarks), tuple(shown))


def _opposite(name: str) -> str:
    return f"joint {name} is reported with the opposite sign"


def _of_torques(data: Regression, currents: Sequence[int]) -> LoggedUnits:
    """Return scale and sign of logged torques, where no mass within its tolerance and no load explain them."""
    numbers = [number for number, joint in enumerate(data.looked_at) if joint not in currents]
    joints = [data.looked_at[number] for number in numbers]
    factors = np.ones(len(data.log.joints))
    if not joints:
        return LoggedUnits(factors)
    scales = _scale_places(data, joints)
    in_amperes = [joint for joint in data.looked_at if joint in currents]
    nuisances = np.sort(np.concatenate([_beside_scales(data), _scale_places(data, in_amperes)]))
    evidence = _cautious(data)
    before = evidence.unseen(nuisances)
    everywhere = np.arange(len(data.looked_at))
    groups = [scales, *(data.columns_of("freed", None, float(body)) for body in data.freed_directions)]
    groups = [group for group in groups if len(group)]
    tables = [
        errors for errors, _ in evidence.unseen_with(nuisances, groups, [everywhere.tolist()] * len(groups))
    ]
    gap = np.nanmean(before, axis=0)
    base, *logs = (log_errors(errors, everywhere.tolist(), gap) for errors in (before, *tables))
    table, units = np.array(logs), units_of(base)
    leader = decide.leader(table, [(len(group), 0) for group in groups], units)
    if leader != 0 or not decide.beats(table[0], base, units):
        return LoggedUnits(factors)
    active = np.concatenate([nuisances, scales])
    gains = 1.0 + evidence.fit(active)[scales]
    needed = [
        _needs(evidence, active, scale, number, gap) for number, scale in zip(numbers, scales, strict=True)
    ]
    names = data.log.joints
    flipped = [joints[number] for number in range(len(joints)) if needed[number] and gains[number] < 0.0]
    sentences = [_opposite(names[joint]) for joint in flipped]
    factors[flipped] = -1.0
    beyond = criteria.WITHIN_TOLERANCES * criteria.MASS_TOLERANCE
    off = [
        number
        for number in range(len(joints))
        if needed[number] and abs(np.log(max(abs(gains[number]), 1e-12))) > np.log1p(beyond)
    ]
    if 2 * len(off) <= len(joints):
        return LoggedUnits(factors, (), tuple(sentences))
    for number in off:
        factors[joints[number]] = 1.0 / gains[number]
    factors_told = ", ".join(f"{names[joints[number]]} {abs(1.0 / gains[number]):.3g}" for number in off)
    sentences.insert(
        0,
        "the log holds no torques in N m (N) but motor currents or another unit: no stated mass explains their size; "
        f"one logged unit is {factors_told} N m (N), if the stated masses are right",
    )
    others = [names[joint] for number, joint in enumerate(joints) if number not in off]
    if others:
        sentences.append(
            f"{', '.join(others)}: the log does not show the unit; sizes there are in logged units"
        )
    return LoggedUnits(factors, tuple(joints[number] for number in off), tuple(sentences))


def _beside_scales(data: Regression) -> IntArray:
    """Return the places of the columns that every model has, with friction of any size."""
    return np.sort(np.concatenate([data.columns_of(kind) for kind in (*_FRICTION, *NUISANCE)]))


def _scale_places(data: Regression, joints: Sequence[int]) -> IntArray:
    return np.array([int(data.columns_of("scale", joint)[0]) for joint in joints], dtype=np.int64)


def _cautious(data: Regression) -> LinearEvidence:
    """Return evidence in which stated masses hold: a trial tells a few independent numbers of each joint."""
    evidence = data.evidence
    friction = np.concatenate([data.columns_of(kind) for kind in _FRICTION])
    errors = evidence.unseen(friction)
    rows = np.array([gram.count.sum() for gram in evidence.grams])
    share = np.minimum(criteria.NUMBERS_A_TRIAL * len(data.log.courses) / np.maximum(rows, 1.0), 1.0)
    return evidence.reweighed(errors, share)


def _needs(evidence: LinearEvidence, active: IntArray, scale: int, number: int, gap: FloatArray) -> bool:
    """Tell whether the scale of one joint is needed beside those of all others."""
    with_it = log_errors(evidence.unseen(active), [number], gap)
    without = log_errors(evidence.unseen(active[active != scale]), [number], gap)
    return decide.beats(with_it, without, units_of(without))


def dead_channels(names: Sequence[str], reasons: Sequence[str]) -> list[str]:
    """Return a sentence for every joint whose torque says nothing."""
    return [
        f"{name}: {reason}; nothing can be said of its torque"
        for name, reason in zip(names, reasons, strict=True)
        if reason
    ]
