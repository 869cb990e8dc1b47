"""A run's folder: made, locked, written trial by trial, found whole again after any crash."""

import json
import secrets
import string
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import ReferenceType

from labrun.errors import RecordingError, RigBusyError, StoreError
from labrun.store.disk import fsync_directory, replace_durably, saving
from labrun.store.journal import Journal
from labrun.store.locking import FileLock
from labrun.store.trial import Status, TrialOutcome
from labrun.store.trial_log import TrialLog
from labrun.store.writer import TrialWriter
from labrun.store.written import Written

if TYPE_CHECKING:
    from labrun.store.packed_file import RunTexts
    from labrun.store.trial_image import Places, Templates

SPEC = "spec.toml"
PROVENANCE = "provenance.json"
JOURNAL = "journal.jsonl"
TRIALS = "trials"
PACKED = "run.h5"


class RunFolder:
    """One run on disk.

    Attributes
    ----------
    path
        The folder.
    journal
        Its events.
    faults
        What was found damaged when the folder was opened, for the person: one sentence each.
    written
        Of trials stored by this object: what allows to read their files without HDF5.
    log
        Makes trials durable before their files are.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.journal = Journal(path / JOURNAL)
        self.faults: list[str] = []
        self.written: dict[int, Written] = {}
        self.log = TrialLog(path / TRIALS, self.journal.sync)
        self._lock = FileLock(path / ".lock", f"run {path}")
        self._depth = 0
        self._known: dict[int, TrialOutcome] | None = None
        self._templates: Templates | None = None
        # In a dry run nothing moves after a trial, so its line in the journal need not wait for the disk: the trial
        # itself is durable, and where its line was lost the log has it, or it is read to the last sample instead.
        self._simulated = False

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
            replace_durably(path / PROVENANCE, _json(provenance))
            replace_durably(path / SPEC, spec_toml.encode())
            fsync_directory(path.parent)
        folder = cls(path)
        folder._simulated = bool(provenance.get("dry_run", False))
        folder._known = {}
        folder.journal.append("created", experiment=experiment)
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Open an existing run and put it in order: see `recover`. Left as it is while another process holds it.

        Raises
        ------
        RecordingError
            This is no run folder, or its journal is damaged before its last line.
        """
        if not (path / SPEC).is_file():
            raise RecordingError(
                f"{path} is no run folder: it has no {SPEC}",
                hint="a run folder is results/<experiment>/<start>-<letters>; labrun list shows what there is",
            )
        folder = cls(path)
        with suppress(OSError, ValueError):  # where nothing tells, it counts as hardware
            folder._simulated = bool(folder.provenance.get("dry_run", False))
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
        return (self.path / SPEC).read_text()

    @property
    def provenance(self) -> dict[str, Any]:
        """Versions, git state, machine, device identities, seed."""
        text = (self.path / PROVENANCE).read_text()
        data: dict[str, Any] = json.loads(text)
        return data

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
            if self.log.path.exists():  # whoever held it last did not end in order
                self._known = None
        self._depth += 1
        try:
            if self._known is None:
                self.recover()
            yield
        except BaseException:
            with suppress(StoreError):  # what ended the session is what counts
                self._leave()
            raise
        self._leave()

    def _leave(self) -> None:
        self._depth -= 1
        if self._depth > 0:
            return
        try:
            if self._known is not None:  # else recovery failed, and needs the log once more
                with suppress(OSError, StoreError):  # the log stays then, for when the run is opened again
                    self.log.settle()
            self.journal.close()
        finally:
            self._lock.release()

    def recover(self) -> None:
        """Put in order what a crash left; needs the lock.

        A torn last journal line is cut off, temporary files are removed, damaged trials are moved aside
        (``trials/000123.h5.damaged``) and count as not run. `faults` tells what was found. Trials that the log has are
        put back from it, silently: these were stored.
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
        if self._templates is None:
            from labrun.store.trial_image import Templates

            self._templates = Templates()
        return TrialWriter(trials, index, self._templates, self.log, self._stored, self._saved)

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
        known = self._known if self._known is not None else self.outcomes()
        if index not in known:
            raise RecordingError(f"{self.path} has no trial {index} to mark as {status}")
        self.journal.append("mark", index=index, status=status, reason=reason)
        known[index] = known[index].marked(status, reason)
        self._known = known

    def pack(self) -> Path:
        """Put the whole run into one file; see `labrun.store.packing.pack`."""
        from labrun.store.packing import pack

        with self.lock():
            return pack(self)

    def texts(self) -> "RunTexts":
        """Return what the run is, beside its trials."""
        from labrun.store.packed_file import RunTexts

        return RunTexts(
            experiment=self.name,
            run=self.path.absolute().name,
            spec_toml=self.spec_toml,
            provenance_json=(self.path / PROVENANCE).read_text(),
            journal_jsonl=self.journal.text(),
        )

    def _stored(
        self, outcome: TrialOutcome, described: Mapping[str, Any], places: "Places | None", logged: bool
    ) -> None:
        self.written.pop(outcome.index, None)
        if places is not None:
            self.written[outcome.index] = Written(described["blake2b"], outcome.tare, ReferenceType(places))
        self._journal_trial(outcome, described, sync=not (self._simulated or logged))
        if self._known is not None:
            self._known[outcome.index] = outcome

    def _journal_trial(self, outcome: TrialOutcome, described: Mapping[str, Any], *, sync: bool) -> None:
        self.journal.append(
            "trial",
            sync=sync,
            index=outcome.index,
            role=outcome.role,
            repeat=outcome.repeat,
            status=outcome.status,
            reason=outcome.reason,
            objectives=outcome.objectives,
            **described,
        )

    def _saved(self) -> str:
        count = len(self._known) if self._known is not None else 0
        return f"{count} trials are saved and untouched"

    def _scan(self, *, repair: bool) -> None:
        from labrun.store import packed_file, trial_file

        events = self.journal.events()
        self.faults = [] if self.journal.torn is None else [self.journal.torn]
        described: dict[int, dict[str, Any]] = {}
        for event in events:
            if event["event"] == "trial":
                described[event["index"]] = event
            elif event["event"] == "damaged":
                described.pop(event["index"], None)
        restored = self._put_back(described) if repair else {}
        found = packed_file.read_outcomes(self.path / PACKED)
        for index, path in trial_file.trial_files(self.path / TRIALS).items():
            try:
                found[index] = trial_file.check(path, described.get(index))
            except RecordingError as error:
                self._set_aside(path, error, repair=repair)
                described.pop(index, None)
                continue
            if index in restored:
                self._journal_trial(found[index], restored[index], sync=False)
        missing = sorted(described.keys() - found.keys())
        self.faults += [
            f"trial {index} is in the journal, but its file is gone: it counts as not run"
            for index in missing
        ]
        self._known = apply_marks(found, events)

    def _put_back(self, described: dict[int, dict[str, Any]]) -> dict[int, dict[str, Any]]:
        """Put the files of logged trials back where they suffered; return those whose line the journal has lost."""
        lost = {}
        for index, logged in self.log.records().items():
            known = described.get(index)
            if known is not None and known.get("blake2b") != logged.digest:
                continue  # stored anew since, and not by the log
            with saving(f"trial {index}", self.path):
                self.log.put_back(index, logged)
            if known is None:
                lost[index] = described[index] = {"bytes": logged.length, "blake2b": logged.digest}
        return lost

    def _set_aside(self, path: Path, error: RecordingError, *, repair: bool) -> None:
        fault = f"{error}; it counts as not run"
        if repair:
            aside = path.with_name(f"{path.name}.damaged")
            path.replace(aside)
            self.journal.append("damaged", index=int(path.stem), file=aside.name, reason=str(error))
            fault += f", and was moved to {aside.name}"
        self.faults.append(fault)


def apply_marks(outcomes: dict[int, TrialOutcome], events: list[dict[str, Any]]) -> dict[int, TrialOutcome]:
    """Return the outcomes with the ``mark`` events of a journal applied in order."""
    marked = dict(outcomes)
    for event in events:
        index = event.get("index")
        if event["event"] == "mark" and index in marked:
            marked[index] = marked[index].marked(event["status"], event["reason"])
        elif event["event"] == "trial" and index in marked:
            marked[index] = outcomes[index]  # stored anew: earlier marks were about its predecessor
    return marked


def _json(data: Mapping[str, Any]) -> bytes:
    return (json.dumps(data, indent=2, default=str) + "\n").encode()


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
