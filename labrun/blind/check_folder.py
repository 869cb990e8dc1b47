"""The folder of a check: sealed cases, replies, and scores."""

import hashlib
import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.blind.jobs import Files
from labrun.errors import LabrunError, RequestError
from labrun.fit import Note
from labrun.interrupts import Interrupted, number_of
from labrun.registry import package_folder
from labrun.store import replace_durably

_GENERATOR = "labrun.cases", "sealed"
"""Entry point of the generator that makes the cases unless another is named: a package that runs as a folder."""
_ASKED = "asked.json"
_MODEL = "model.toml"
_SEAL = "seal.json"
_SEALED = "sealed"
_NOT_SCORED = "nothing was scored; have the cases made again in a new folder (--out)"
_TOLD_LINES = 12


@dataclass(frozen=True)
class CheckFolder:
    """The folder of a check.

    ``cases`` is all that a diagnosis sees; ``fresh`` is for what comes after it; ``sealed`` is opened last.
    """

    path: Path

    @property
    def made(self) -> bool:
        """Tell whether the cases exist."""
        return (self.path / _SEAL).is_file()

    def ask(self, asked: Mapping[str, Any]) -> str:
        """Store the request and the seal, or check that the stored request is the same; return the seal.

        Raises RequestError: the folder holds another check, or its seal is no longer the one that was printed.
        """
        path = self.path / _ASKED
        seal = seal_of(self.path)
        if not path.is_file():
            names = sealed_cases(self.path)
            if names != [f"case-{asked['first'] + number:04d}" for number in range(asked["cases"])]:
                raise RequestError(
                    f"{self.path} holds {len(names)} cases from {names[0] if names else 'none'} on; "
                    f"requested are {asked['cases']} from case-{asked['first']:04d} on",
                    hint="ask for what is there, or name a new folder with --out",
                )
            _write(path, {**asked, "seal": seal})
            return seal
        before = json.loads(path.read_text(encoding="utf-8"))
        if {key: before.get(key) for key in asked} != dict(asked):
            raise RequestError(
                f"{self.path} holds a check of {_words(before)}; requested is one of {_words(asked)}",
                hint="name a new folder with --out",
            )
        return str(before["seal"])

    def cases(self) -> list[str]:
        """Return the names of the cases, in order."""
        return sealed_cases(self.path)

    def seen(self, case: str) -> Files:
        """Return the files that a diagnosis may see."""
        return _files(self.path / "cases" / case)

    def fresh(self, case: str) -> Files:
        """Return the files of the fresh trials."""
        return _files(self.path / "fresh" / case)

    def model(self, case: str) -> bytes:
        """Return the model file of a case."""
        return (self.path / "cases" / case / _MODEL).read_bytes()

    def reply(self, case: str, programme: str, tool: str = "") -> dict[str, Any] | None:
        """Return the kept reply to a case; None if there is none yet, or by other code than `programme`.

        Parameters
        ----------
        tool
            Name of the tool that replied; labrun itself if "".
        """
        kept = _read(self._reply_path(case, tool))
        return kept if kept is not None and kept.get("programme") == programme else None

    def keep_reply(self, case: str, reply: Mapping[str, Any], tool: str = "") -> None:
        """Store the reply to a case, and remove fresh-trial results of an earlier one."""
        if not tool:
            (self.path / "shrinkage" / f"{case}.json").unlink(missing_ok=True)
        _write(self._reply_path(case, tool), reply)

    def _reply_path(self, case: str, tool: str) -> Path:
        folder = self.path / "tools" / tool if tool else self.path / "diagnoses"
        return folder / f"{case}.json"

    def shown(self, case: str) -> dict[str, Any] | None:
        """Return the result of the fresh trials of a case, or None."""
        return _read(self.path / "shrinkage" / f"{case}.json")

    def keep_shown(self, case: str, shown: Mapping[str, Any]) -> None:
        """Store the result of the fresh trials of a case."""
        _write(self.path / "shrinkage" / f"{case}.json", shown)

    def keep_scores(self, scores: Mapping[str, Any]) -> None:
        """Write ``check.json``."""
        _write(self.path / "check.json", scores)


@contextmanager
def kept_when_interrupted(folder: CheckFolder, what: str) -> Iterator[None]:
    """Turn Ctrl-C into an error that says how to continue; finished `what` are kept."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise Interrupted(
            number_of(error),
            f"; every {what} that was finished is kept",
            hint=f"the same command continues: {folder.path}",
        ) from None


def prepare(
    folder: CheckFolder,
    *,
    generator: Path | None = None,
    cases: int,
    seed: int,
    first: int,
    only: str | None,
    data: Sequence[str] = (),
    workers: int,
    note: Note,
) -> str:
    """Generate the cases unless they exist; return the line with the seal.

    Parameters
    ----------
    generator
        Folder of the code that makes them; if None, that of the entry point ``sealed`` of group ``labrun.cases``.
    only
        Kind of all cases; the generator's mixture of kinds if None.
    data
        What all recordings are to be like, as ``repeats=1`` or ``noise=pink``.

    Raises
    ------
    RequestError
        The folder holds something else, or there is no such generator.
    PluginError
        No generator is installed.
    LabrunError
        The generator failed, with the last lines of what it said.
    """
    if folder.made:
        return f"seal {seal_of(folder.path)}  (cases that were there, in {folder.path})"
    if folder.path.exists() and (not folder.path.is_dir() or any(folder.path.iterdir())):
        raise RequestError(
            f"{folder.path} already exists and is not a check",
            hint="name a new folder with --out",
        )
    if generator is not None and not (generator / "__main__.py").is_file():
        raise RequestError(
            f"{generator} makes no cases: it has no __main__.py",
            hint="leave out --generator for the cases that come with labrun",
        )
    note("making the cases")
    folder.path.parent.mkdir(parents=True, exist_ok=True)
    command = [
        sys.executable,
        str(generator or package_folder(*_GENERATOR)),
        "--cases",
        str(cases),
        "--seed",
        str(seed),
    ]
    command += ["--first", str(first), "--workers", str(workers), "--out", str(folder.path)]
    command += [] if only is None else ["--only", only]
    command += [f"--{option}" for option in data]
    return _made(command, note)


def _made(command: Sequence[str], note: Note) -> str:
    """Run the generator; return its line with the seal."""
    messages: list[str] = []
    with tempfile.TemporaryFile("w+", encoding="utf-8") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.PIPE, text=True, encoding="utf-8")
        try:
            for line in process.stderr or ():
                messages = [*messages[1 - _TOLD_LINES :], line.rstrip()]
                if line.startswith("made "):
                    note(f"making the cases: {line.strip()}")
            code = process.wait()
        except BaseException:
            _stop(process)
            raise
        file.seek(0)
        seal = file.read().strip()
    if code != 0 or not seal:
        raise LabrunError(
            f"the generator {command[1]} ended with exit code {code}:\n    " + "\n    ".join(messages),
            hint=f"to see it alone: {' '.join(command)}",
        )
    return seal.splitlines()[0]


def seal_of(folder: Path) -> str:
    """Return the hash over all answers, as the folder's seal states it. Raises RequestError: the folder has no seal."""
    return _stated(folder).over_all


def sealed_cases(folder: Path) -> list[str]:
    """Return the names of the cases that are sealed, in order."""
    return sorted(_stated(folder).cases)


def open_answers(folder: Path, printed: str) -> list[dict[str, Any]]:
    """Check every answer against the seal that was printed before, then return them in the order of their names.

    `printed`: hash over all answers, as it was told before the first diagnosis. Raises LabrunError: the seal is another
    than the one that was printed, or an answer is not the one that was sealed.
    """
    seal = _stated(folder)
    faults = []
    if printed != seal.over_all or not seal.holds_together:
        faults.append(f"{folder / _SEAL} is not the seal that was printed before the diagnosis")
    sealed = folder / _SEALED
    try:
        salt = (sealed / "salt.txt").read_text(encoding="utf-8").strip().encode()
    except OSError as error:
        raise LabrunError(
            f"cannot verify the seal: the salt file is missing: {error}", hint=_NOT_SCORED
        ) from error
    sealed_bytes = {path.stem: path.read_bytes() for path in sorted(sealed.glob("case-*.json"))}
    faults += [
        f"{sealed / name}.json is in no seal" for name in sorted(sealed_bytes.keys() - seal.cases.keys())
    ]
    for name, expected in sorted(seal.cases.items()):
        if name not in sealed_bytes:
            faults.append(f"{sealed / name}.json is missing")
        elif hashlib.sha256(salt + sealed_bytes[name]).hexdigest() != expected:
            faults.append(f"{sealed / name}.json was changed after it was sealed")
    if faults:
        raise LabrunError("the seal is broken:\n    " + "\n    ".join(faults), hint=_NOT_SCORED)
    return [json.loads(sealed_bytes[name]) for name in sorted(sealed_bytes)]


@dataclass(frozen=True, slots=True)
class _Seal:
    over_all: str
    cases: Mapping[str, str]

    @property
    def holds_together(self) -> bool:
        """Tell whether the hash over all is that of the hashes of the cases."""
        listed = "".join(f"{name}:{self.cases[name]}\n" for name in sorted(self.cases))
        return hashlib.sha256(listed.encode()).hexdigest() == self.over_all


def _stated(folder: Path) -> _Seal:
    try:
        content = json.loads((folder / _SEAL).read_text(encoding="utf-8"))
        return _Seal(str(content["all"]), {str(name): str(case) for name, case in content["cases"].items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RequestError(
            f"{folder} holds no sealed cases ({type(error).__name__}: {error})",
            hint="name a new folder with --out",
        ) from error


def _stop(process: "subprocess.Popen[str]") -> None:
    """Interrupt the generator, so that it removes its incomplete folder."""
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


def _files(folder: Path) -> Files:
    try:
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}
    except OSError as error:
        raise RequestError(
            f"a case cannot be read: {error}", hint="have the cases made again in a new folder (--out)"
        ) from error


def _read(path: Path) -> dict[str, Any] | None:
    try:
        loads = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return loads if isinstance(loads, dict) else None


def _write(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file whole or not at all: an interruption must not leave half an answer."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_durably(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def _words(asked: Mapping[str, Any]) -> str:
    kinds = f" (only {asked['only']})" if asked.get("only") else ""
    return f"{asked['cases']} cases{kinds} of seed {asked['seed']}, from case {asked['first']}"
