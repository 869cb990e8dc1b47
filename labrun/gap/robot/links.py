"""Links that are not where their encoders say: behind a gear that gives way, or with play.

Such a link pulls at its neighbours as if something were missing there, too, often by more than at its own joint, whose
encoder sits on the motor. Each neighbour alone then tells a cause of its own. The true one is known by what it does to
the others: with the link where it is, they lack nothing.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect
from labrun.fit import FitTrial, silent
from labrun.gap import criteria
from labrun.gap.averaging import averaged
from labrun.gap.candidates import candidates, site_scales
from labrun.gap.held_out import fitted_excess
from labrun.gap.recalibration import Recalibrated, recalibrate
from labrun.gap.robot.one_joint import OneJoint, Prescribed, one_joint
from labrun.gap.screening import Base, follow, rough, survey
from labrun.models import Model, RobotJoint, simulate

Links = dict[int, list[FloatArray]]
"""How far joints are from what was measured of them, by place and trial."""


def beside_encoders(
    prescribed: Prescribed, answers: Sequence[tuple[OneJoint, Sequence[AttachedEffect], Mapping[str, float]]]
) -> Links:
    """Return how far joints are from what was measured of them, as the causes there say.

    Of every joint the causes and the parameters beside them are given.
    """
    courses = {index: _beside(prescribed, index, *answer) for index, answer in enumerate(answers)}
    return {index: course for index, course in courses.items() if course}


def _beside(
    prescribed: Prescribed,
    joint_index: int,
    joint: OneJoint,
    effects: Sequence[AttachedEffect],
    corrected: Mapping[str, float],
) -> list[FloatArray]:
    """Return how far a joint is from what was measured of it in every trial; empty where no cause says that it is."""
    soft = [effect for effect in effects if effect.effect.kind == "link"]
    sensors = [effect for effect in effects if effect.effect.kind == "output" and not joint.by_torque]
    by: list[FloatArray] = []
    if soft:
        each = range(len(joint.dataset.trials))
        by = [-soft[0].values[0] * prescribed.carried(number, joint_index)[0][:, 0] for number in each]
    elif sensors:
        rest = [effect for effect in effects if effect not in sensors]
        link = joint.model.with_values(corrected).with_effects(rest)
        by = [
            _alone(link, trial, joint.joint) - _alone(link.with_effects(sensors), trial, joint.joint)
            for trial in joint.dataset.trials
        ]
    return by if by and np.isfinite(np.concatenate(by)).all() else []


def _alone(model: Model, trial: FitTrial, joint: RobotJoint) -> FloatArray:
    """Return the angle that a joint's own model makes of a trial, which begins as it was measured."""
    names = [signal.name for signal in model.inputs]
    begin = [trial.inputs[0, names.index("measured")], trial.inputs[0, names.index("measured_rate")]]
    made = simulate(model, trial.time_s, trial.inputs, condition=trial.condition, initial_state=begin)
    return made.outputs[:, [output.name for output in model.outputs].index(joint.output)]


def links_that_explain(prescribed: Prescribed, lacking: Sequence[int], seed: int) -> Links:
    """Return the links that are not where their encoders say, of joints by which others lack less than half as much.

    Whoever explains most of the others is taken first; the others are asked beside it.

    Parameters
    ----------
    lacking
        The joints whose gap is more than recalibration explains.
    """
    known: Links = {}
    if len(lacking) < 2:
        return known
    alone = {index: one_joint(prescribed, index) for index in lacking}
    fitted = {index: _recalibrated(joint, seed) for index, joint in alone.items()}
    had = {index: _gap(fit) for index, fit in fitted.items()}
    asked = [
        (index, by)
        for index in lacking
        for by in _that_explain_their_own(prescribed, index, alone[index], fitted[index])
    ]
    while asked:
        most, best, after = 0.0, None, had
        for index, by in asked:
            around = prescribed.with_links({**known, index: by})
            others = [other for other in had if other != index and other not in known]
            left = {other: _gap(_recalibrated(one_joint(around, other), seed)) for other in others}
            explained = {other for other, gap in left.items() if gap < criteria.MOST * had[other]}
            removed = sum(had[other] ** 2 - left[other] ** 2 for other in explained)
            if removed > most:
                most, best, after = removed, (index, by), {**had, **left}
        if best is None:
            break
        index, by = best
        known[index], had = by, after
        # what asked for a link there may have been this one
        asked = [pair for pair in asked if pair[0] != index and after[pair[0]] >= criteria.LEAST_JOINT_GAP]
    return known


def _that_explain_their_own(
    prescribed: Prescribed, joint_index: int, joint: OneJoint, fitted: Recalibrated
) -> Iterator[list[FloatArray]]:
    """Yield where a link may be beside its encoder: as causes say that leave less than half of the joint's own gap."""
    problem, z = fitted.problem, fitted.z
    base, had = Base.of(problem, z, brisk=True), _gap(fitted)
    every = [
        survey(base, candidate)
        for candidate in candidates(problem.model, site_scales(problem, z), ())
        if candidate.attached is not None and candidate.attached.effect.kind in ("link", "output")
    ]
    every = sorted((each for each in every if each.starts), key=lambda each: -each.potential)
    for each in every[: criteria.LINKS_ASKED]:
        end = follow(base, rough(base, each))
        left = fitted_excess(end.problem, end.z, fitted.noise).gap
        if left >= criteria.MOST * had:
            continue
        values = end.problem.model_parameters(end.z)
        named = {
            each.name: float(value) for each, value in zip(problem.model.parameters, values, strict=True)
        }
        by = _beside(
            prescribed, joint_index, joint, end.problem.attached(end.problem.parameters(end.z)), named
        )
        if by:
            yield by


def _recalibrated(joint: OneJoint, seed: int) -> Recalibrated:
    return recalibrate(joint.model, averaged(joint.dataset, joint.model), np.random.default_rng(seed), silent)


def _gap(fitted: Recalibrated) -> float:
    return fitted_excess(fitted.problem, fitted.z, fitted.noise).gap
