"""What the diagnosis says of real recordings, beside what is published of them, and how long it takes.

    python benchmarks/recordings.py FOLDER               # one row per recording in it
    python benchmarks/recordings.py FOLDER --splits      # EMPS and Silverbox: corrected on half, simulated on the rest
    python benchmarks/recordings.py FOLDER --single      # each trial alone: how sure its causes are, how often right

FOLDER holds recordings (folders with recording.toml and model.toml); LABRUN_RECORDINGS names it if none is given. Each
is diagnosed once, with the simple model beside it and nothing else said. Seconds are of the processor, all processes.

The splits are not those of the benchmarks, whose test parts (EMPS: the record with pulses; Silverbox: the drive of
growing amplitude) are not among these recordings: the model is corrected by the first half of the parts, and tested on
the other half, each part simulated whole from a fitted beginning.

A cause that one trial alone announces is right if it, or the one rival told beside it, is among those that all trials
together announce, or are said to be like: of EMPS, Silverbox, O-ring and forearm these are the published ones.
"""

import argparse
import os
import resource
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it

import numpy as np

from labrun.app.question import ask
from labrun.gap import Options, diagnose_dataset, predict_fresh
from labrun.report.gap_words import value_words
from labrun.report.text import percent

PUBLISHED = {
    "emps": "Coulomb friction 20.3 N and a constant force (Janot et al. 2019)",
    "silverbox": "cubic stiffness (Wigren and Schoukens 2013)",
    "o-ring": "Coulomb friction: half of 7.84, 10.88, 13.84, 15.62 N at 1, 3, 5, 7 bar (authors' script)",
    "tx40-forearm": "dry friction 2.48/48 = 0.0517, offset -0.102/48 = -0.0021, motor inertia (figaroh-examples)",
}
SPLITS = {
    "emps": ("published 0.45 to 2 mm on another record", 1e3, "mm"),
    "silverbox": ("published 0.30 to 0.36 mV on another drive", 1e3, "mV"),
}


def seconds() -> float:
    """Return the processor's time of this process and of those it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(getrusage.ru_utime + getrusage.ru_stime for getrusage in used)


def said_of(folder: Path, workers: int) -> list[str]:
    """Return a row of the table."""
    begin, clock = seconds(), time.perf_counter()
    question = ask(folder, None)
    dataset = diagnose_dataset(question.dataset, question.model, Options(places=False, workers=workers))
    causes = []
    for cause in dataset.causes:
        rivals = "".join(f" or {name.words}" for name in cause.indistinguishable_from)
        values = ", ".join(value_words(cause.values))
        causes.append(f"{cause.name.words}{rivals} ({values}; {percent(cause.confidence)})")
    share = "" if dataset.shrinkage is None else percent(dataset.shrinkage.value)
    return [
        folder.name,
        f"{dataset.trials} trials, {dataset.repeats} of each",
        PUBLISHED.get(folder.name, "not known"),
        dataset.verdict,
        "; ".join(causes) or "no cause",
        share,
        f"{seconds() - begin:.0f} s ({time.perf_counter() - clock:.0f} s)",
    ]


def split(folder: Path, workers: int) -> list[str]:
    """Return what a model corrected by the first half of the parts leaves of the other half, and one fitted to them."""
    question = ask(folder, None)
    trials = question.dataset.trials
    half = len(trials) // 2
    seen, unseen = (replace(question.dataset, trials=part) for part in (trials[:half], trials[half:]))
    dataset = diagnose_dataset(seen, question.model, Options(places=False, workers=workers))
    corrected = question.model.with_values(dataset.corrected).with_effects(dataset.effects)
    result = predict_fresh(
        corrected, unseen, np.random.default_rng(0), before=question.model, horizons_s=(0.1,)
    )
    whole = next(prediction for prediction in result.predictions if prediction.horizon_s is None)
    words, factor, unit = SPLITS[folder.name]
    return [
        folder.name,
        f"corrected by {half} parts, simulated on {len(trials) - half}",
        f"{factor * whole.error.value:.3g} {unit} [{factor * whole.error.low:.3g}, {factor * whole.error.high:.3g}]",
        f"as it was {factor * whole.before.value:.3g} {unit}",
        "; ".join(cause.name.words for cause in dataset.causes),
        words,
    ]


def alone(folder: Path, workers: int) -> list[str]:
    """Return how many causes single trials announce, how many of them are right, and how sure they are said to be."""
    question, options = ask(folder, None), Options(places=False, workers=workers)
    whole = diagnose_dataset(question.dataset, question.model, options)
    true = {name for cause in whole.causes for name in (cause.name, *cause.indistinguishable_from)}
    causes = []
    for trial in question.dataset.trials:
        data = replace(question.dataset, trials=(trial,))
        causes += [(trial.label, cause) for cause in diagnose_dataset(data, question.model, options).causes]
    wrong = [
        f"{label}: {cause.name.words} ({percent(cause.confidence)})"
        for label, cause in causes
        if not true & {cause.name, *cause.indistinguishable_from[:1]}
    ]
    message = np.mean([cause.confidence for _, cause in causes]) if causes else float("nan")
    return [
        folder.name,
        f"{len(question.dataset.trials)} trials",
        f"{len(causes)} causes, {len(causes) - len(wrong)} right, told with {percent(message)}"
        if causes
        else "no cause",
        "; ".join(wrong),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", default=os.environ.get("LABRUN_RECORDINGS"), type=Path)
    parser.add_argument(
        "--splits", action="store_true", help="halves of EMPS and Silverbox instead of the table"
    )
    parser.add_argument("--single", action="store_true", help="every trial by itself instead of the table")
    parser.add_argument("--only", help="one recording by its name")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    if given.folder is None or not given.folder.is_dir():
        parser.error("name the folder of the recordings, or set LABRUN_RECORDINGS")
    folders = sorted(path.parent for path in given.folder.glob("*/recording.toml"))
    wanted = [
        folder
        for folder in folders
        if given.only in (None, folder.name) and (not given.splits or folder.name in SPLITS)
    ]
    if not wanted:
        parser.error(
            f"no such recording in {given.folder}: it holds {', '.join(folder.name for folder in folders) or 'none'}"
        )
    for folder in wanted:
        row = (split if given.splits else alone if given.single else said_of)(folder, given.workers)
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
