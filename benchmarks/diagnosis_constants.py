"""What the diagnosis says of recordings whose causes are known, with each of its constants halved and doubled.

    python benchmarks/diagnosis_constants.py FOLDER [--only MARGIN --only RATED ...] [--recordings NAME ...]

FOLDER holds recordings (folders with recording.toml and model.toml) and truth.toml, which lists the causes of each:
``causes = [{ any = ["coulomb-friction", ...], site = "hinge" }]`` and ``beside = [...]``, what may be announced, too.
Of a robot, ``robot = ["arm.xml", "log.csv"]`` names its file and its log, and ``options = ["--unit", "rad"]`` the unit.
LABRUN_RECORDINGS names the folder if none is given. A recording is *right* if every cause is announced and nothing else
is, *partly right* if one is, else *wrong*. Prints a row for each constant in Markdown: the table of
docs/development/diagnosis-constants.md.
"""

import argparse
import os
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it

from labrun.app.diagnose_robot import robot_of
from labrun.app.logs import import_log
from labrun.app.question import ask
from labrun.gap import Diagnosis, Options, criteria, diagnose_dataset, diagnose_robot

CONSTANTS = tuple(name for name in vars(criteria) if name.isupper())


Announced = set[tuple[str, str]]
"""Effect and site of a cause and of all its rivals."""
Answer = Callable[[], list[Announced]]


def announced(diagnosis: Diagnosis) -> list[Announced]:
    """Return the effects among the causes of a diagnosis, each with its rivals."""
    return [
        {(name.effect, name.site) for name in (cause.name, *cause.indistinguishable_from)}
        for cause in diagnosis.causes
        if cause.name.kind == "effect"
    ]


def judged(sets: Sequence[Announced], truth: Mapping[str, Any]) -> str:
    """Return whether what was announced is right, partly right, or wrong."""

    def holds(members: Announced, cause: Mapping[str, Any]) -> bool:
        return any(effect in cause["any"] and cause.get("site", site) == site for effect, site in members)

    allowed = set(truth.get("beside", ()))
    met = [any(holds(members, cause) for members in sets) for cause in truth["causes"]]
    true = [
        any(effect in allowed for effect, _ in members)
        or any(holds(members, cause) for cause in truth["causes"])
        for members in sets
    ]
    if all(met) and all(true):
        return "right"
    return "partly right" if any(true) else "wrong"


def recording(folder: Path) -> Answer:
    """Return the diagnosis of a recording, to be made any number of times."""
    question = ask(folder, None)
    return lambda: announced(diagnose_dataset(question.dataset, question.model, Options(places=False)))


def robot(folder: Path, truth: Mapping[str, Any], imported: Path) -> Answer:
    """Return the diagnosis of a robot's log, joint by joint and as a whole, to be made any number of times."""
    file, log = (folder / name for name in truth["robot"])
    unit = truth["options"][1] if truth.get("options") else None
    question = ask(import_log(log, file, imported, unit=unit).folder, None)
    of_file = robot_of(imported, question.dataset)

    def answer() -> list[Announced]:
        diagnosis = diagnose_robot(
            of_file, question.model, question.dataset, Options(places=False, workers=1)
        )
        joints = [members for joint in diagnosis.joints for members in announced(joint.diagnosis)]
        return [*joints, *({(effect, "")} for effect, _, _ in diagnosis.whole)]

    return answer


def score(answers: Mapping[str, Answer], truths: Mapping[str, Any]) -> Counter[str]:
    """Diagnose everything, and count how the answers agree with the truth."""
    return Counter(judged(answer(), truths[name]) for name, answer in answers.items())


def row(name: str, value: object, tallies: Sequence[Counter[str]]) -> str:
    """Return a row of the table: right, partly right and wrong with the constant as it is, halved and doubled."""
    cells = [f"{tally['right']} / {tally['partly right']} / {tally['wrong']}" for tally in tallies]
    return f"| `{name}` | {value} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", default=os.environ.get("LABRUN_RECORDINGS"))
    parser.add_argument("--only", action="append", choices=CONSTANTS)
    parser.add_argument("--recordings", nargs="*")
    options = parser.parse_args()
    folder = Path(options.folder)
    truths = tomllib.loads((folder / "truth.toml").read_text())
    truths = {
        name: truth for name, truth in truths.items() if not options.recordings or name in options.recordings
    }
    with tempfile.TemporaryDirectory() as scratch:
        answers = {
            name: robot(folder / name, truth, Path(scratch) / name)
            if "robot" in truth
            else recording(folder / name)
            for name, truth in truths.items()
        }
    print(f"{len(truths)} recordings: {', '.join(truths)}. Right / partly right / wrong.\n")
    print("| constant | value | as it is | halved | doubled |\n|---|---|---|---|---|")
    usual = score(answers, truths)
    for name in options.only or CONSTANTS:
        value = getattr(criteria, name)
        tallies = [usual]
        for factor in (0.5, 2.0):
            changed = max(round(factor * value), 1) if isinstance(value, int) else factor * value
            if changed == value:
                tallies.append(usual)
                continue
            setattr(criteria, name, changed)
            try:
                tallies.append(score(answers, truths))
            finally:
                setattr(criteria, name, value)
        print(row(name, value, tallies), flush=True)


if __name__ == "__main__":
    main()
