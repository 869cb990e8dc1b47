"""What unit and sign the logged torque of each joint has: torques, motor currents, or one with the opposite sign."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.gap import criteria, decide
from labrun.gap.robot.linear_evidence import LinearEvidence, log_errors, units_of
from labrun.gap.robot.torque_columns import NUISANCE, Regression

_FRICTION = ("coulomb", "viscous", "offset")


@dataclass(frozen=True)
class LoggedUnits:
    """How logged torques become those that act on the joints.

    Attributes
    ----------
    factors : (joints,)
        What each is multiplied by.
    unknown
        Joints whose factor is an estimate, so that their scale is fitted beside everything else.
    sentences
        What to know of it.
    """

    factors: FloatArray
    unknown: tuple[int, ...] = ()
    sentences: tuple[str, ...] = ()

    @property
    def as_logged(self) -> bool:
        """Tell whether the log is taken as it is."""
        return bool(np.all(self.factors == 1.0))


def logged_units(data: Regression) -> LoggedUnits:
    """Find scale and sign of each joint's logged torque, where no mass within its tolerance and no load explain them.

    The stated links are what scales are told by. Friction of any size stands beside them at every joint.
    """
    joints = data.looked_at
    factors = np.ones(len(data.log.joints))
    scales = np.array([int(data.columns_of("scale", joint)[0]) for joint in joints])
    nuisances = np.sort(np.concatenate([data.columns_of(kind) for kind in (*_FRICTION, *NUISANCE)]))
    evidence = _cautious(data)
    before = evidence.unseen(nuisances)
    everywhere = np.arange(len(joints))
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
    needed = [_needs(evidence, active, scale, number, gap) for number, scale in enumerate(scales)]
    names = data.log.joints
    flipped = [joints[number] for number in range(len(joints)) if needed[number] and gains[number] < 0.0]
    sentences = [f"joint {names[joint]} is reported with the opposite sign" for joint in flipped]
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
    message = ", ".join(f"{names[joints[number]]} {abs(1.0 / gains[number]):.3g}" for number in off)
    sentences.insert(
        0,
        "the log holds no torques in N m (N) but motor currents or another unit: no stated mass explains their size; "
        f"one logged unit is {message} N m (N), if the stated masses are right",
    )
    others = [names[joint] for number, joint in enumerate(joints) if number not in off]
    if others:
        sentences.append(
            f"{', '.join(others)}: the log does not show the unit; sizes there are in logged units"
        )
    return LoggedUnits(factors, tuple(joints[number] for number in off), tuple(sentences))


def _cautious(data: Regression) -> LinearEvidence:
    """Return evidence in which stated masses hold: a trial tells a few independent numbers of each joint."""
    evidence = data.evidence
    friction = np.concatenate([data.columns_of(kind) for kind in _FRICTION])
    errors = evidence.unseen(friction)
    rows = np.array([gram.count.sum() for gram in evidence.grams])
    share = np.minimum(criteria.NUMBERS_A_TRIAL * len(data.log.courses) / np.maximum(rows, 1.0), 1.0)
    return evidence.reweighed(errors, share)


def _needs(
    evidence: LinearEvidence, active: IntArray, joint_index: int, number: int, gap: FloatArray
) -> bool:
    """Tell whether the scale of one joint is needed beside those of all others."""
    with_it = log_errors(evidence.unseen(active), [number], gap)
    without = log_errors(evidence.unseen(active[active != joint_index]), [number], gap)
    return decide.beats(with_it, without, units_of(without))


def dead_channels(names: Sequence[str], reasons: Sequence[str]) -> list[str]:
    """Return a sentence for every joint whose torque says nothing."""
    return [
        f"{name}: {reason}; nothing can be said of its torque"
        for name, reason in zip(names, reasons, strict=True)
        if reason
    ]
