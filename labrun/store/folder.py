"""A run's folder: made, locked, written trial by trial, packed into one file, found whole again after any crash."""

import json
import secrets
import string
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrun.errors import RecordingError, RigBusyError, StoreError
from labrun.signals import LongSignals
from labrun.store import packed_file
from labrun.store.disk import (
    FileLock,
    InaccessibleError,
    fsync_directory,
    fsync_file,
    opening,
    replace_durably,
    saving,
)
from labrun.store.journal import Journal
from labrun.store.locate import JOURNAL, PACKED, PROVENANCE, SPEC, TRIALS
from labrun.store.packed_file import FORMAT, PackedTrials, RunTexts, older
from labrun.store.trial import Status, TrialOutcome
from labrun.store.trial_file import TrialFile, TrialWriter, check, trial_files


class TrialSource:
    """The signals of a run's trials, wherever they are; a trial file counts before ``run.h5``.

    Parameters
    ----------
    packed
        ``run.h5``, opened when it is needed; may be missing.
    locked
        As for `labrun.store.trial_file.TrialFile`.
    """

    def __init__(self, packed: Path, files: Mapping[int, Path], *, locked: bool = True) -> None:
        self._locked = locked
        self._path = packed
        self._files = files
        self._packed: PackedTrials | None = None

    @contextmanager
    def tables(self, index: int) -> Iterator[dict[str, LongSignals]]:
        """Give all signals of one trial by name: devices, ``command``, ``settle``; readable within the ``with``.

        Raises RecordingError: there is no such trial.
        """
        path = self._files.get(index)
        if path is not None:
            with TrialFile(path, locked=self._locked) as file:
                yield file.tables()
            return
        if self._packed is None and self._path.is_file():
            self._packed = PackedTrials(self._path, locked=self._locked)
        if self._packed is None or index not in self._packed:
            raise RecordingError(f"{self._path.parent} has no trial {index}")
        yield self._packed.tables(index)

    def size(self) -> int:
        """Return how many bytes all trials take on disk now."""
        packed = self._path.stat().st_size if self._path.is_file() else 0
        return packed + sum(path.stat().st_size for path in self._files.values())

    def close(self) -> None:
        """Close ``run.h5``."""
        if self._packed is not None:
            self._packed.close()
            self._packed = None


class RunFolder:
    """One run on disk.

    Attributes
    ----------
    faults
        What was found damaged when the folder was opened, for the person: one sentence each.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.journal = Journal(path / JOURNAL)
        self.faults: list[str] = []
        self._lock = FileLock(path / ".lock", f"run {path}")
        self._depth = 0
        self._known: dict[int, TrialOutcome] | None = None

    @property
    def _durable(self) -> bool:
        """Tell whether trials and events are synced: a dry run need not survive a power cut."""
        return self.journal.durable

    @classmethod
    def create(
        cls, results: Path, experiment: str, spec_toml: str, provenance: Mapping[str, Any]
    ) -> "RunFolder":
        """Make a new run: ``<results>/<experiment>/<UTC start>-<4 letters>``.

        Raises
        ------
        StoreError
            The folder cannot be written.
        """
        with saving(f"a new run of {experiment}", results, "nothing was begun"):
            (results / experiment).mkdir(parents=True, exist_ok=True)
            path = _new_folder(results / experiment)
            (path / TRIALS).mkdir()
            written = json.dumps(provenance, indent=2, default=str) + "\n"
            replace_durably(path / PROVENANCE, written.encode())
            replace_durably(path / SPEC, spec_toml.encode())
            fsync_directory(path.parent)
        folder = cls(path)
        folder.journal.durable = not provenance.get("dry_run", False)
        folder._known = {}
        folder.journal.append("created", experiment=experiment, format=FORMAT)
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Open an existing run and put it in order: see `recover`. Left as it is while another process holds it.

        Raises
        ------
        RecordingError
            This is no run folder, or one that older code made; or its journal is damaged before its last line.
        """
        if not (path / SPEC).is_file():
            raise RecordingError(
                f"{path} is not a run folder: it lacks {SPEC}",
                hint="a run folder is results/<experiment>/<start>-<letters>; labrun list shows what there is",
            )
        folder = cls(path)
        require_current(folder.journal.events(), path)
        with suppress(RecordingError):  # where nothing tells, it counts as hardware
            folder.journal.durable = not folder.provenance.get("dry_run", False)
        try:
            with folder.lock():
                pass
        except RigBusyError:
            folder._scan(repair=False)
        return folder

    @property
    def name(self) -> str:
        """The experiment's name."""
        return self.path.absolute().parent.name

    @property
    def spec_toml(self) -> str:
        """The resolved experiment file."""
        with opening(self.path / SPEC):
            return (self.path / SPEC).read_text()

    @property
    def provenance(self) -> dict[str, Any]:
        """Versions, git state, machine, device identities, seed; RecordingError where it is missing or damaged."""
        try:
            data: dict[str, Any] = json.loads(self._provenance_json())
        except ValueError as error:
            raise RecordingError(f"{self.path / PROVENANCE} is damaged: {error}", hint=_RESTORE) from error
        return data

    def _provenance_json(self) -> str:
        try:
            with opening(self.path / PROVENANCE):
                return (self.path / PROVENANCE).read_text()
        except InaccessibleError as error:
            if (self.path / PROVENANCE).exists():
                raise
            raise RecordingError(
                f"{self.path} has no {PROVENANCE}, which tells how the run was made", hint=_RESTORE
            ) from error

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the run for this process; may be entered again by who holds it.

        Raises
        ------
        RigBusyError
            Another process holds it; names it.
        """
        if self._depth == 0:
            self._lock.acquire()
        self._depth += 1
        try:
            if self._known is None:
                self.recover()
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                try:
                    self.journal.close()
                finally:
                    self._lock.release()

    def recover(self) -> None:
        """Put in order what a crash left; needs the lock.

        A torn last journal line is cut off, temporary files are removed, damaged trials are moved aside
        (``trials/000123.h5.damaged``) and count as not run. `faults` tells what was found.
        """
        self.journal.repair()
        with saving("the removal of temporary files", self.path):
            for partial in [
                *self.path.glob("*.partial"),
                *self.path.glob(".*.partial"),
                *self.path.glob("trials/.*.partial"),
            ]:
                partial.unlink(missing_ok=True)
        self._scan(repair=True)

    def writer(self, index: int) -> TrialWriter:
        """Return what stores the trial with this index."""
        trials = self.path / TRIALS
        if not trials.is_dir():
            trials.mkdir()
            fsync_directory(self.path)
        return TrialWriter(trials, index, sync=self._durable, stored=self._stored, saved=self._saved)

    def outcomes(self) -> dict[int, TrialOutcome]:
        """Return the outcome of every stored trial by index, in order, with later marks applied."""
        if self._known is None:
            self._scan(repair=False)
        return dict(sorted((self._known or {}).items()))

    def mark(self, index: int, status: Status, reason: str) -> None:
        """Change the status of a stored trial, for example when the outlier rule rejects it later.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        known = self._with_trial(index, f"mark as {status}")
        self.journal.append("mark", index=index, status=status, reason=reason)
        known[index] = known[index].marked(status, reason)

    def correct(self, index: int, objectives: Mapping[str, float]) -> None:
        """Replace values of a stored trial that a person typed; the journal keeps those of before.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        known = self._with_trial(index, "correct")
        self.journal.append("corrected", index=index, objectives=dict(objectives))
        known[index] = known[index].corrected(objectives)

    def _with_trial(self, index: int, purpose: str) -> dict[int, TrialOutcome]:
        """Return the outcomes as they are known; RecordingError unless the trial is among them."""
        if self._known is None:
            self._scan(repair=False)
        if self._known is None or index not in self._known:
            raise RecordingError(f"{self.path} has no trial {index} to {purpose}")
        return self._known

    def pack(self) -> Path:
        """Put all trials into ``run.h5``, verify it, and only then remove the trial files.

        A run that was packed before and went on is packed anew from both. A crash at any instant leaves the old
        state, the new state, or the new state with trial files that are in it too.

        Returns
        -------
        Path
            The packed file.

        Raises
        ------
        StoreError
            The disk is full, or what was written differs from the trials: these are untouched, ``run.h5`` as before.
        """
        with self.lock():
            target = self.path / PACKED
            outcomes = self.outcomes()
            paths = trial_files(self.path / TRIALS)
            files = {index: path for index, path in paths.items() if index in outcomes}
            if files or not target.is_file() or packed_file.read_outcomes(target) != outcomes:
                self._write_packed(target, outcomes, TrialSource(target, files))
            self.journal.append("packed", trials=len(outcomes))
            # Damaged trials that were moved aside stay, with their folder.
            with saving("the removal of packed trials", self.path, f"everything is in {PACKED}"):
                for path in files.values():
                    path.unlink()
                with suppress(OSError):
                    (self.path / TRIALS).rmdir()
                if self._durable:
                    fsync_directory(self.path)
            return target

    def _write_packed(self, target: Path, outcomes: Mapping[int, TrialOutcome], source: TrialSource) -> None:
        partial = target.with_name(f"{PACKED}.partial")
        untouched = f"all {len(outcomes)} trials are untouched"
        try:
            with saving(PACKED, self.path, untouched):
                sums = packed_file.write_packed(partial, self.texts(), outcomes, source.tables, source.size())
                if self._durable:
                    fsync_file(partial)
                if not packed_file.holds(partial, outcomes, sums):
                    raise StoreError(
                        f"{partial} does not hold what was written to it; {untouched}",
                        hint="the disk or the memory of this machine may be failing: copy the run elsewhere",
                    )
                partial.replace(target)
                if self._durable:
                    fsync_directory(self.path)
        finally:
            source.close()
            with suppress(OSError):
                partial.unlink(missing_ok=True)

    def texts(self) -> RunTexts:
        """Return what the run is, beside its trials."""
        return RunTexts(
            experiment=self.name,
            run=self.path.absolute().name,
            spec_toml=self.spec_toml,
            provenance_json=self._provenance_json(),
            journal_jsonl=self.journal.text(),
        )

    def _stored(self, outcome: TrialOutcome, described: Mapping[str, Any]) -> None:
        self.journal.append(
            "trial",
            index=outcome.index,
            role=outcome.role,
            repeat=outcome.repeat,
            status=outcome.status,
            reason=outcome.reason,
            objectives=outcome.objectives,
            **described,
        )
        if self._known is not None:
            self._known[outcome.index] = outcome

    def _saved(self) -> str:
        count = len(self._known) if self._known is not None else 0
        return f"{count} trials are saved and untouched"

    def _scan(self, *, repair: bool) -> None:
        events = self.journal.events()
        self.faults = [] if self.journal.torn is None else [self.journal.torn]
        described: dict[int, dict[str, Any]] = {}
        for event in events:
            if event["event"] == "trial":
                described[event["index"]] = event
            elif event["event"] == "damaged":
                described.pop(event["index"], None)
        outcomes = packed_file.read_outcomes(self.path / PACKED)
        for index, path in trial_files(self.path / TRIALS).items():
            try:
                outcomes[index] = check(path, described.get(index))
            except InaccessibleError:
                raise
            except RecordingError as error:
                self._set_aside(path, error, repair=repair)
                described.pop(index, None)
        missing = sorted(described.keys() - outcomes.keys())
        self.faults += [
            f"trial {index} is in the journal, but its file is gone: it counts as not run"
            for index in missing
        ]
        self._known = apply_marks(outcomes, events)

    def _set_aside(self, path: Path, error: RecordingError, *, repair: bool) -> None:
        fault = f"{error}; it counts as not run"
        if repair:
            aside = path.with_name(f"{path.name}.damaged")
            path.replace(aside)
            self.journal.append("damaged", index=int(path.stem), file=aside.name, reason=str(error))
            fault += f", and was moved to {aside.name}"
        self.faults.append(fault)


_RESTORE = "restore it from a copy of the run; the trials themselves are untouched"


def require_current(events: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Raise RecordingError where the journal tells that older code made the run."""
    if events and events[0].get("event") == "created" and events[0].get("format") != FORMAT:
        raise older(path)


def apply_marks(outcomes: dict[int, TrialOutcome], events: list[dict[str, Any]]) -> dict[int, TrialOutcome]:
    """Return the outcomes with the ``mark`` and ``corrected`` events of a journal applied in order."""
    marked = dict(outcomes)
    for event in events:
        index = event.get("index")
        if event["event"] == "mark" and index in marked:
            marked[index] = marked[index].marked(event["status"], event["reason"])
        elif event["event"] == "corrected" and index in marked:
            marked[index] = marked[index].corrected(event["objectives"])
        elif event["event"] == "trial" and index in marked:
            marked[index] = outcomes[index]  # stored anew: earlier marks were about its predecessor
    return marked


def _new_folder(parent: Path) -> Path:
    while True:
        start = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
        letters = "".join(secrets.choice(string.ascii_lowercase) for _ in range(4))
        path = parent / f"{start}-{letters}"
        try:
            path.mkdir()
        except FileExistsError:
            continue
        return path
