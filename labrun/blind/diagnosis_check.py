"""Run a check: generate and seal cases, diagnose them, open the seal, score."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labrun.blind.check_folder import CheckFolder, kept_when_interrupted, open_answers, prepare
from labrun.blind.jobs import diagnose_case, fingerprint, shrink_case
from labrun.blind.judging import Judged, Reply, Shown, judge
from labrun.blind.scoring import Scores, score
from labrun.blind.tool import LIMIT_S, Tool, ask_tool, tools_of
from labrun.blind.truth import KINDS, Truth
from labrun.errors import RequestError
from labrun.fit import Note, silent
from labrun.toml import suggest
from labrun.workers import Pool, cores, pool, spread

FIRST_REPORTED_SEED = 1000
"""Seeds below are for development; those from here on are for figures that are reported."""
LABRUN = "labrun"
_STREAM = 30313
"""Keeps seeds of diagnoses apart from those of the cases."""

Job = tuple[str, Callable[..., dict[str, Any]], tuple[Any, ...]]


@dataclass(frozen=True)
class Scored:
    """Every case as one program answered it, and the scores.

    Attributes
    ----------
    name
        "labrun", or that of a tool.
    command
        Of a tool, as words; empty for labrun.
    """

    name: str
    command: tuple[str, ...]
    judged: tuple[Judged, ...]
    scores: Scores

    def to_json(self) -> dict[str, Any]:
        """Return the fields JSON-ready."""
        return {
            "name": self.name,
            "command": list(self.command),
            "figures": self.scores.to_json(),
            "cases": [_case(judged) for judged in self.judged],
        }


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
        Fingerprints of labrun's code that diagnosed; more than one where workers differ.
    labrun, tools
        Scores of labrun, and of every other program on the same cases.
    """

    seed: int
    only: str | None
    seal: str
    folder: Path
    programmes: tuple[str, ...]
    labrun: Scored
    tools: tuple[Scored, ...] = ()

    @property
    def judged(self) -> tuple[Judged, ...]:
        """Every case as labrun answered it, in order."""
        return self.labrun.judged

    @property
    def scores(self) -> Scores:
        """The scores of labrun."""
        return self.labrun.scores

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
        """Return a sentence on whether the figures of this seed may be reported."""
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
            "cases": [_case(judged) for judged in self.judged],
            "tools": [tool.to_json() for tool in self.tools],
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
    tools: Sequence[str] = (),
    tool_limit_s: float | None = None,
    note: Note = silent,
    announce: Callable[[str], None] | None = None,
) -> Checked:
    """Generate sealed cases, diagnose each without its answer, then open the seal and score.

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
    tools
        Commands of other programs that are asked about the same cases: the folder of a case is added to each as its
        last argument, and it prints an `labrun.blind.Answer` as JSON.
    tool_limit_s
        Wall time that such a program may take for one case; 120 s if None.
    note
        Told what is being done.
    announce
        Told the seal, before anything is diagnosed; standard error if None.

    Raises
    ------
    RequestError
        No such generator, tool, cluster or kind of case, or a folder that holds something else.
    LabrunError
        The generator failed, a worker died, the seal is broken, or Ctrl-C.
    """
    workers = workers or cores()
    only = only if only is None else kind_named(only)
    asked_tools = tools_of(tools, LIMIT_S if tool_limit_s is None else tool_limit_s)
    if asked_tools and cluster is not None:
        raise RequestError(
            "--tool runs a program of this machine, which the workers of a cluster do not have",
            hint="leave out --cluster; diagnoses that the cluster made are kept in the folder",
        )
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
        with pool(workers, cluster) as workers_pool:
            diagnoses = _diagnosed(folder, seed, workers_pool, note)
            note("simulating the corrected models on fresh trials")
            shown = _shown(folder, seed, diagnoses, workers_pool)
            replies = {tool: _asked(folder, tool, workers_pool, note) for tool in asked_tools}
    note("opening the seal")
    truths = [Truth.from_json(answer) for answer in open_answers(folder.path, printed)]
    _as_asked(truths, seed, only, folder.path)
    judged = tuple(
        judge(
            truth,
            Reply.of_labrun(diagnoses[truth.case]),
            Shown.from_json(shown[truth.case]) if truth.case in shown else None,
        )
        for truth in truths
    )
    programmes = tuple(sorted({str(diagnosis["programme"]) for diagnosis in diagnoses.values()}))
    result = Checked(
        seed,
        only,
        printed,
        folder.path,
        programmes,
        Scored(LABRUN, (), judged, score(judged)),
        tuple(_scored(tool, truths, replies[tool]) for tool in asked_tools),
    )
    folder.keep_scores(result.to_json())
    return result


def _scored(tool: Tool, truths: Sequence[Truth], replies: Mapping[str, Mapping[str, Any]]) -> Scored:
    judged = tuple(judge(truth, Reply.of_tool(replies[truth.case])) for truth in truths)
    return Scored(tool.name, tool.command, judged, score(judged))


def kind_named(only: str) -> str:
    """Return the kind of case that a person means, in the singular. Raises RequestError: there is no such kind."""
    if only.removesuffix("s") in KINDS:
        return only.removesuffix("s")
    raise RequestError(f"unknown kind of case {only!r}", hint=suggest(only, KINDS, kind="kinds"))


def case_seed(seed: int, case: str) -> int:
    """Return the seed of a case's diagnosis, from its number alone."""
    number = int(case.rpartition("-")[2])
    return int(np.random.SeedSequence([seed, _STREAM, number]).generate_state(1)[0])


def _case(judged: Judged) -> dict[str, Any]:
    truth, reply, shown = judged.truth, judged.reply, judged.shown
    return {
        "case": truth.case,
        "outcome": judged.outcome,
        "false_causes": judged.false_causes,
        "kind": truth.kind,
        "bench": truth.bench,
        "gap": truth.gap,
        "strength": truth.strength,
        "repeats": truth.repeats,
        "noise": truth.noise,
        "zeros_by_trial": truth.zeros,
        "hidden": [cause.model_dump() for cause in truth.causes],
        "forms": list(truth.forms),
        "answer": None if reply.answer is None else reply.answer.model_dump(mode="json"),
        "no_answer": reply.reason,
        "predicted_share": None
        if reply.predicted is None
        else {"value": reply.predicted.value, "ci90": [reply.predicted.low, reply.predicted.high]},
        "true_share": None if shown is None else asdict(shown),
        "processor_s": reply.processor_s,
    }


def _diagnosed(folder: CheckFolder, seed: int, workers: Pool, note: Note) -> dict[str, dict[str, Any]]:
    """Return labrun's diagnosis of every case; cases that were diagnosed before are not diagnosed again."""
    names = folder.cases()
    replies = {name: kept for name in names if (kept := folder.reply(name, fingerprint())) is not None}
    missing = [name for name in names if name not in replies]

    def jobs() -> Iterator[Job]:
        for name in missing:
            yield name, diagnose_case, (name, folder.seen(name), case_seed(seed, name))

    note(f"diagnosing: {len(replies)} of {len(names)} there")
    for name, diagnosis in spread(workers, jobs()):
        folder.keep_reply(name, diagnosis)
        replies[name] = diagnosis
        note(f"diagnosing: {len(replies)} of {len(names)} there, {name} {diagnosis.get('verdict', 'failed')}")
    return {name: replies[name] for name in names}


def _asked(folder: CheckFolder, tool: Tool, workers: Pool, note: Note) -> dict[str, dict[str, Any]]:
    """Return what a tool printed for every case; it is not asked again about cases that it has answered."""
    names, programme = folder.cases(), tool.fingerprint
    replies = {name: kept for name in names if (kept := folder.reply(name, programme, tool.name)) is not None}
    missing = [name for name in names if name not in replies]

    def jobs() -> Iterator[Job]:
        for name in missing:
            yield name, ask_tool, (tool, name, folder.seen(name))

    note(f"{tool.name}: {len(replies)} of {len(names)} there")
    for name, printed in spread(workers, jobs()):
        replies[name] = {**printed, "programme": programme}
        folder.keep_reply(name, replies[name], tool.name)
        note(f"{tool.name}: {len(replies)} of {len(names)} there, {name} {printed.get('error', 'answered')}")
    return {name: replies[name] for name in names}


def _shown(
    folder: CheckFolder, seed: int, answers: Mapping[str, Mapping[str, Any]], workers: Pool
) -> dict[str, dict[str, Any]]:
    """Return what fresh trials showed of every case in which labrun claims a cause."""
    replies = {name: Reply.of_labrun(diagnosis) for name, diagnosis in answers.items()}
    claimed = [name for name, reply in replies.items() if reply.answer is not None and reply.answer.causes]
    shown = {name: kept for name in claimed if (kept := folder.shown(name)) is not None}
    missing = [name for name in claimed if name not in shown]

    def jobs() -> Iterator[Job]:
        for name in missing:
            arguments = (name, folder.fresh(name), folder.model(name), answers[name], case_seed(seed, name))
            yield name, shrink_case, arguments

    for name, share in spread(workers, jobs()):
        folder.keep_shown(name, share)
        shown[name] = share
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
    kinds += "".join(f"{option.replace('=', '-')}-" for option in data)
    return Path("gap-check") / f"seed-{seed}-{kinds}cases-{first}-to-{first + cases - 1}"
