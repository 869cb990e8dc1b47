"""The check on sealed robots: made, diagnosed joint by joint, their seal opened, scored."""

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.blind.answer import Answer
from labrun.blind.check_folder import CheckFolder, kept_when_interrupted, open_answers, prepare, seal_of
from labrun.blind.diagnosis_check import FIRST_REPORTED_SEED, case_seed
from labrun.blind.jobs import fingerprint
from labrun.fit import Note, load_dataset, silent
from labrun.gap import Options, diagnose_robot
from labrun.json_numbers import finite
from labrun.models import load_model, read_robot
from labrun.workers import cores

ROBOT = "robot"
PLAIN_GAP = 3.0
"""Gap, in units of the noise, from which a hidden effect has to be named."""
_MOST_NAMED = 2
_WHOLE = {"gravity": "gravity-tilt", "payload": "payload"}


@dataclass(frozen=True)
class JudgedJoint:
    """One joint of one robot: what was hidden there, and what the diagnosis named.

    Attributes
    ----------
    hidden, gap
        Empty and 0 where nothing was hidden.
    named
        Every announced cause with what it cannot be told from, the cause first.
    right
        Whether the hidden effect is among them; of a joint without, whether nothing was announced.
    """

    case: str
    joint: str
    hidden: str
    gap: float
    named: tuple[tuple[str, ...], ...]
    right: bool


@dataclass(frozen=True)
class CheckedRobots:
    """Scores of a check on robots, and every joint behind them."""

    seed: int
    seal: str
    folder: Path
    joints: tuple[JudgedJoint, ...]
    whole: tuple[tuple[str, str, bool], ...]
    seconds: Mapping[str, float]

    def named(self, least: float = PLAIN_GAP, most: float = float("inf")) -> tuple[int, int]:
        """Return how many of the hidden effects with a gap in between were named, and how many there are."""
        hidden = [joint for joint in self.joints if joint.hidden and least <= joint.gap < most]
        return sum(joint.right for joint in hidden), len(hidden)

    @property
    def false_alarms(self) -> tuple[int, int]:
        """Joints without anything hidden at which a cause was announced, and how many such joints there are."""
        without_effect = [joint for joint in self.joints if not joint.hidden]
        return sum(not joint.right for joint in without_effect), len(without_effect)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap check --only robots --json`` prints."""
        return {
            "seed": self.seed,
            "development": self.seed < FIRST_REPORTED_SEED,
            "seal": self.seal,
            "named_from_gap_3": list(self.named()),
            "named_below": list(self.named(0.0, PLAIN_GAP)),
            "false_alarms": list(self.false_alarms),
            "whole": [{"case": case, "hidden": hidden, "named": named} for case, hidden, named in self.whole],
            "joints": [
                {
                    "case": joint.case, "joint": joint.joint, "hidden": joint.hidden or None, "gap": joint.gap,
                    "said": [list(names) for names in joint.named], "right": joint.right,
                }
                for joint in self.joints
            ],
            "seconds": dict(self.seconds),
        }  # fmt: skip

    def to_text(self) -> str:
        """Return the scores, and every joint that was not right."""
        right, hidden_count = self.named()
        weak, weak_there = self.named(0.0, PLAIN_GAP)
        wrong, plain = self.false_alarms
        use = "of development" if self.seed < FIRST_REPORTED_SEED else "for reporting, once"
        lines = [
            f"seed {self.seed} ({use}); {len(self.seconds)} robots, {len(self.joints)} joints",
            f"joint and effect named where the gap is 3 and more: {right} of {hidden_count}",
            f"                             where it is less: {weak} of {weak_there}",
            f"causes at joints without: {wrong} of {plain}",
            f"tilted bases and payloads named: {sum(judged[2] for judged in self.whole)} of {len(self.whole)}",
        ]
        for joint in self.joints:
            if not joint.right:
                message = "; ".join(" or ".join(names) for names in joint.named) or "nothing"
                hidden = f"{joint.hidden}, gap {joint.gap:.2g}" if joint.hidden else "nothing"
                lines.append(f"  {joint.case} {joint.joint}: hidden {hidden}; said {message}")
        return "\n".join([*lines, str(self.folder)])


def check_robots(
    *,
    cases: int = 10,
    seed: int = 0,
    workers: int | None = None,
    out: Path | None = None,
    note: Note = silent,
) -> CheckedRobots:
    """Have sealed robots made, diagnose each joint by joint without its answer, then open the seal and score.

    Every diagnosis is written as soon as it is there; the same call goes on where an earlier one was interrupted.

    Raises
    ------
    RequestError
        A folder that holds something else.
    LabrunError
        The generator failed, the seal is broken, or Ctrl-C.
    """
    folder = CheckFolder(out or Path("gap-check") / f"seed-{seed}-only-robot-cases-1-to-{cases}")
    with kept_when_interrupted(folder, "robot"):
        prepare(folder, cases=cases, seed=seed, first=1, only=ROBOT, workers=1, note=note)
        printed = folder.ask({"cases": cases, "seed": seed, "first": 1, "only": ROBOT})
        print(f"seal {seal_of(folder.path)}  ({cases} robots, in {folder.path})", file=sys.stderr, flush=True)
        replies = {name: _said(folder, name, seed, workers or cores(), note) for name in folder.cases()}
    note("opening the seal")
    joints: list[JudgedJoint] = []
    whole: list[tuple[str, str, bool]] = []
    for answer in open_answers(folder.path, printed):
        joints += _judged(answer, replies[answer["case"]]["joints"], whole)
    seconds = {name: float(timing["seconds"]) for name, timing in replies.items()}
    robots = CheckedRobots(seed, printed, folder.path, tuple(joints), tuple(whole), seconds)
    folder.keep_scores(robots.to_json())
    return robots


def _said(folder: CheckFolder, name: str, seed: int, workers: int, note: Note) -> Mapping[str, Any]:
    """Return what is said of a robot, joint by joint; what was said before by the same code is not said again."""
    kept = folder.reply(name, fingerprint())
    if kept is not None:
        return kept
    counter = time.perf_counter()
    with tempfile.TemporaryDirectory() as directory:
        for file, content in folder.seen(name).items():
            (Path(directory) / file).write_bytes(content)
        robot, model = read_robot(Path(directory) / "robot.xml"), load_model(Path(directory) / "robot.xml")
        dataset = load_dataset(Path(directory), model)
        options = Options(seed=case_seed(seed, name), workers=workers)
        diagnosis = diagnose_robot(robot, model, dataset, options, note=lambda text: note(f"{name}: {text}"))
    clock = [[diagnosis.clock]] if diagnosis.clock else []
    joints = {
        joint.joint.name: [
            *clock,
            *_sets(joint.diagnosis.to_json()),
            *([f"{name} at {joint.joint.name}"] for name in joint.moved),
        ]
        for joint in diagnosis.joints
    }
    reply = {"programme": fingerprint(), "joints": joints, "seconds": time.perf_counter() - counter}
    folder.keep_reply(name, reply)
    return reply


def _sets(printed: Mapping[str, Any]) -> list[list[str]]:
    """Return the causes that a diagnosis claims, each with its rivals."""
    answer = Answer.of_diagnosis(finite(printed))
    return [
        [f"{member.effect} at {member.site or 'model'}" for member in cause.members]
        for cause in answer.causes
    ]


def _judged(
    answer: Mapping[str, Any],
    answers: Mapping[str, Sequence[Sequence[str]]],
    whole: list[tuple[str, str, bool]],
) -> list[JudgedJoint]:
    hidden = {effect["joint"]: effect for effect in answer["hidden"]}
    of_all = {_WHOLE[name] for name in answer["whole"]}
    judged_joints = []
    for joint, causes in answers.items():
        joint_names = tuple(tuple(names) for names in causes)
        hidden_effect = hidden.get(joint)
        if hidden_effect is None:
            # a tilted base and a load are there at every joint
            right = all(_effects(names) & of_all for names in joint_names)
            judged_joints.append(JudgedJoint(answer["case"], joint, "", 0.0, joint_names, right))
            continue
        wanted = (
            {hidden_effect["effect"], f"{joint}_kp"}
            if hidden_effect["effect"] == "drive-gain"
            else {hidden_effect["effect"]}
        )
        right = any(len(names) <= _MOST_NAMED and _effects(names) & wanted for names in joint_names)
        judged_joints.append(
            JudgedJoint(
                answer["case"], joint, hidden_effect["effect"], hidden_effect["gap"], joint_names, right
            )
        )
    for effect in sorted(of_all):
        named = any(effect in _effects(names) for causes in answers.values() for names in causes)
        whole.append((answer["case"], effect, named))
    return judged_joints


def _effects(names: Sequence[str]) -> set[str]:
    return {name.partition(" at ")[0] for name in names}
