"""The whole check: cases made and sealed, diagnosed, their seal opened, scored."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labrun.blind.check_folder import CheckFolder, kept_when_interrupted, open_answers, prepare
from labrun.blind.jobs import diagnose_case, shrink_case
from labrun.blind.judging import ANNOUNCING, KINDS, Judged, Said, Shown, Truth, judge
from labrun.blind.scoring import Scores, score
from labrun.errors import RequestError
from labrun.fit import Note, silent
from labrun.toml import suggest
from labrun.workers import Pool, cores, pool, spread

FIRST_REPORTED_SEED = 1000
"""Seeds below are for development; those from here on are for figures that are reported."""
_STREAM = 30313
"""Keeps seeds of diagnoses apart from those of the cases."""


@dataclass(frozen=True)
class Checked:
    """Scores of a check and every case behind them.

    Attributes
    ----------
    only
        Kind of all cases; None where they are the generator's mixture.
    seal
        Hash over all answers that was printed before the first diagnosis; they were found to be the sealed ones.
    folder
        Where cases, diagnoses, answers and scores are.
    programmes
        Fingerprints of the code that diagnosed; more than one where workers differ.
    judged
        Every case, in order.
    """

    seed: int
    only: str | None
    seal: str
    folder: Path
    programmes: tuple[str, ...]
    judged: tuple[Judged, ...]
    scores: Scores

    @property
    def development(self) -> bool:
        """Tell whether the seed is one that the diagnosis may have been tuned on."""
        return self.seed < FIRST_REPORTED_SEED

    @property
    def mixed(self) -> bool:
        """Tell whether there is more than one kind of case."""
        return len(self.scores.kinds) > 1

    @property
    def use(self) -> str:
        """What the seed says about the figures, in a sentence."""
        if self.development:
            return f"seed {self.seed} is one of development (below {FIRST_REPORTED_SEED}): not for reporting"
        return f"seed {self.seed} is one for reporting: to be used once, with nothing tuned on it"

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap check --json`` prints."""
        return {
            "seed": self.seed,
            "only": self.only,
            "development": self.development,
            "seal": self.seal,
            "seal_holds": True,
            "programmes": list(self.programmes),
            "figures": self.scores.to_json(),
            "cases": [_case(one) for one in self.judged],
        }


def check(
    *,
    cases: int = 60,
    seed: int = 0,
    first: int = 1,
    only: str | None = None,
    data: Sequence[str] = (),
    workers: int | None = None,
    cluster: str | None = None,
    generator: Path | None = None,
    out: Path | None = None,
    note: Note = silent,
    announce: Callable[[str], None] | None = None,
) -> Checked:
    """Have sealed cases made, diagnose each of them without its answer, then open the seal and score.

    Every diagnosis is written as soon as it is there; the same call goes on where an earlier one was interrupted.

    Parameters
    ----------
    cases
        How many.
    seed
        Of the cases; with a case's number also that of its diagnosis. Below 1000 it is one of development.
    first
        Number of the first case.
    only
        Kind of all cases ("control", "effect", "pair", "parameter" or "outside", an s behind it or not); the
        generator's mixture of kinds if None. No job that diagnoses is told.
    data
        What all recordings are to be like: ``repeats=N``, ``conditions=N``, ``noise=COLOUR``, ``zeros`` or
        ``no-zeros``; drawn if not given.
    workers
        Processes; one per core if None. Results do not depend on it.
    cluster
        Address of a Dask scheduler to compute on instead, as ``tcp://host:8786``.
    generator
        Folder of the code that makes the cases; that which comes with labrun if None.
    out
        Folder for cases and results; below ``gap-check`` in the working directory if None.
    note
        Told what is being done.
    announce
        Told the seal, before anything is diagnosed; standard error if None.

    Raises
    ------
    RequestError
        No such generator, no cluster, no such kind of case, or a folder that holds something else.
    LabrunError
        The generator failed, a worker died, the seal is broken, or Ctrl-C.
    """
    workers = workers or cores()
    only = only if only is None else kind_named(only)
    folder = CheckFolder(out or _default_folder(cases, seed, first, only, data))
    with kept_when_interrupted(folder, "diagnosis"):
        line = prepare(
            folder,
            generator=generator,
            cases=cases,
            seed=seed,
            first=first,
            only=only,
            data=data,
            workers=workers,
            note=note,
        )
        asked = {"cases": cases, "seed": seed, "first": first, "only": only}
        printed = folder.ask(asked | ({"data": list(data)} if data else {}))
        if announce is None:
            print(line, file=sys.stderr, flush=True)
        else:
            announce(line)
        with pool(workers, cluster) as there:
            said = _diagnosed(folder, seed, there, note)
            note("simulating the corrected models on fresh trials")
            shown = _shown(folder, seed, said, there)
    note("opening the seal")
    truths = [Truth.from_json(answer) for answer in open_answers(folder.path, printed)]
    _as_asked(truths, seed, only, folder.path)
    judged = tuple(
        judge(
            truth,
            Said.from_json(truth.case, said[truth.case]),
            Shown.from_json(shown[truth.case]) if truth.case in shown else None,
        )
        for truth in truths
    )
    programmes = tuple(sorted({str(one["programme"]) for one in said.values()}))
    result = Checked(seed, only, printed, folder.path, programmes, judged, score(judged))
    folder.keep_scores(result.to_json())
    return result


def kind_named(only: str) -> str:
    """Return the kind of case that a person means, in the singular. Raises RequestError: there is no such kind."""
    if only.removesuffix("s") in KINDS:
        return only.removesuffix("s")
    raise RequestError(f"there is no kind of case {only!r}", hint=suggest(only, KINDS, kind="kinds"))


def case_seed(seed: int, case: str) -> int:
    """Return the seed of a case's diagnosis, from its number alone."""
    number = int(case.rpartition("-")[2])
    return int(np.random.SeedSequence([seed, _STREAM, number]).generate_state(1)[0])


def _case(one: Judged) -> dict[str, Any]:
    truth, said, shown = one.truth, one.said, one.shown
    return {
        "case": truth.case,
        "outcome": one.outcome,
        "kind": truth.kind,
        "bench": truth.bench,
        "gap": truth.gap,
        "strength": truth.strength,
        "repeats": truth.repeats,
        "noise": truth.noise,
        "zeros_by_trial": truth.zeros,
        "hidden": [asdict(cause) for cause in truth.causes],
        "forms": list(truth.forms),
        "verdict": said.verdict,
        "named": [
            {
                **asdict(named.top),
                "confidence": named.confidence,
                "indistinguishable_from": [asdict(rival) for rival in named.rivals],
            }
            for named in said.announced
        ],
        "predicted_shrinkage": None
        if said.shrinkage is None
        else {"value": said.shrinkage.value, "ci90": [said.shrinkage.low, said.shrinkage.high]},
        "true_shrinkage": None if shown is None else asdict(shown),
        "error": said.error,
        "seconds": said.seconds,
    }


def _diagnosed(folder: CheckFolder, seed: int, there: Pool, note: Note) -> dict[str, dict[str, Any]]:
    """Return what was said of every case; cases that were diagnosed before are not diagnosed again."""
    names = folder.cases()
    kept = {name: said for name in names if (said := folder.said(name)) is not None}
    missing = [name for name in names if name not in kept]
    said = dict(kept)

    def jobs() -> Iterator[tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]]:
        for name in missing:
            yield name, diagnose_case, (name, folder.seen(name), case_seed(seed, name))

    note(f"diagnosing: {len(kept)} of {len(names)} there")
    for name, found in spread(there, jobs()):
        folder.keep_said(name, found)
        said[name] = found
        note(f"diagnosing: {len(said)} of {len(names)} there, {name} {found.get('verdict', 'failed')}")
    return {name: said[name] for name in names}


def _shown(
    folder: CheckFolder, seed: int, said: Mapping[str, Mapping[str, Any]], there: Pool
) -> dict[str, dict[str, Any]]:
    """Return what fresh trials showed of every case in which a cause was announced."""
    announced = [name for name, one in said.items() if one.get("verdict") in ANNOUNCING and one["causes"]]
    shown = {name: found for name in announced if (found := folder.shown(name)) is not None}
    missing = [name for name in announced if name not in shown]

    def jobs() -> Iterator[tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]]:
        for name in missing:
            arguments = (name, folder.fresh(name), folder.model(name), said[name], case_seed(seed, name))
            yield name, shrink_case, arguments

    for name, found in spread(there, jobs()):
        folder.keep_shown(name, found)
        shown[name] = found
    return shown


def _as_asked(truths: list[Truth], seed: int, only: str | None, folder: Path) -> None:
    """Refuse cases that were not made as asked: the folder may come from a call of the generator alone."""
    kinds = sorted({truth.kind for truth in truths} - {only}) if only else []
    if kinds:
        raise RequestError(
            f"the cases in {folder} are not of kind {only} only: some are of kind {', '.join(kinds)}",
            hint="name a new folder with --out",
        )
    other = sorted({truth.seed for truth in truths} - {seed})
    if other:
        raise RequestError(
            f"the cases in {folder} were made with seed {other[0]}, not {seed}",
            hint="name a new folder with --out",
        )


def _default_folder(cases: int, seed: int, first: int, only: str | None, data: Sequence[str]) -> Path:
    kinds = "" if only is None else f"only-{only}-"
    kinds += "".join(f"{one.replace('=', '-')}-" for one in data)
    return Path("gap-check") / f"seed-{seed}-{kinds}cases-{first}-to-{first + cases - 1}"
