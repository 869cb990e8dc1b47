"""Seals: what a dry run hides, kept with the run where nobody reads it by accident.

``seal.json`` holds the answer as base64 of compressed JSON, with a salt, beside the SHA-256 of salt and answer; that
hash stands in provenance.json as well. It is a seal, not a lock: whoever decodes it on purpose can. What it promises is
that nobody is told without asking, and that an answer which was changed after the run began is found out.
"""

import base64
import binascii
import hashlib
import json
import secrets
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labrun.errors import RecordingError
from labrun.store import replace_durably, saving

SEAL = "seal.json"
SEALED = "sealed_sha256"
"""Key of provenance.json that says a run is sealed: the hash of its seal."""

_TELLING = ("--hide", "--hide-seed")
_FILLED_BYTES = 600
_NOTE = (
    "What this dry run hides is in here, encoded so that nobody reads it by accident. "
    "labrun gap reveal opens it, and notes that it did."
)


@dataclass(frozen=True, slots=True)
class Seal:
    """A sealed answer.

    Attributes
    ----------
    sha256
        Of salt and answer.
    answer
        Encoded.
    sealed_at
        When, UTC, ISO 8601.
    opened_at
        Every time it was opened.
    """

    sha256: str
    answer: str
    sealed_at: str
    opened_at: tuple[str, ...] = ()

    @classmethod
    def of(cls, hidden: Sequence[Mapping[str, Any]], salt: str | None = None) -> "Seal":
        """Seal what is hidden, JSON-ready; an empty list says that nothing is. The salt is drawn if None."""
        text = json.dumps(
            {"salt": secrets.token_hex(16) if salt is None else salt, "hidden": list(hidden)}, sort_keys=True
        )
        packed = zlib.compress(text.encode(), 9)
        # Filled up, so that its length does not tell how much is hidden, or whether anything is.
        filling = secrets.token_bytes(-len(packed) % _FILLED_BYTES)
        return cls(_sha256(text), base64.b64encode(packed + filling).decode("ascii"), _now())

    def hidden(self) -> list[dict[str, Any]]:
        """Return the answer, once it is known to be the one that was sealed.

        Raises
        ------
        RecordingError
            It was changed, or cannot be decoded.
        """
        try:
            text = zlib.decompressobj().decompress(base64.b64decode(self.answer, validate=True)).decode()
            hidden = json.loads(text)["hidden"]
        except (binascii.Error, zlib.error, ValueError, KeyError, TypeError) as error:
            raise _broken(f"its answer cannot be decoded ({error})") from None
        if _sha256(text) != self.sha256:
            raise _broken("its answer is not the one that its hash was made of")
        return [dict(one) for one in hidden]

    def opened(self) -> "Seal":
        """Return the seal with a note that it is opened now."""
        return replace(self, opened_at=(*self.opened_at, _now()))


def write_seal(run: Path, seal: Seal) -> None:
    """Put a seal into a run folder.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    record = {
        "note": _NOTE,
        "sealed_at": seal.sealed_at,
        "sha256": seal.sha256,
        "answer": seal.answer,
        "opened_at": list(seal.opened_at),
    }
    with saving(SEAL, run):
        replace_durably(run / SEAL, (json.dumps(record, indent=2) + "\n").encode())


def is_sealed(provenance: Mapping[str, Any]) -> bool:
    """Tell whether a run began with something sealed, even if that is nothing."""
    return SEALED in provenance


def read_seal(run: Path, provenance: Mapping[str, Any]) -> Seal:
    """Return the seal of a run, unopened.

    Parameters
    ----------
    run
        The run's folder.
    provenance
        The run's, which says which seal it began with.

    Raises
    ------
    RecordingError
        The run is not sealed, the seal is gone or no seal, or it is not the one that the run began with.
    """
    if not is_sealed(provenance):
        raise RecordingError(
            f"nothing is sealed in {run}", hint="labrun run NAME --dry-run --hide random seals what it hides"
        )
    path = run / SEAL
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        seal = Seal(
            str(record["sha256"]),
            str(record["answer"]),
            str(record["sealed_at"]),
            tuple(str(moment) for moment in record["opened_at"]),
        )
    except FileNotFoundError:
        raise _broken(f"{path} is gone") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _broken(f"{path} cannot be read as a seal ({error})") from None
    if seal.sha256 != provenance[SEALED]:
        raise _broken(
            f"{path} is not the seal that the run began with: the hash in its provenance is another"
        )
    return seal


def redacted(command: Sequence[str]) -> list[str]:
    """Return a command line without what it says of the hidden."""
    kept: list[str] = []
    for word in command:
        if kept and kept[-1] in _TELLING:
            kept.append("(sealed)")
        elif word.partition("=")[0] in _TELLING and "=" in word:
            kept.append(f"{word.partition('=')[0]}=(sealed)")
        else:
            kept.append(word)
    return kept


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _broken(what: str) -> RecordingError:
    return RecordingError(
        f"the seal is broken: {what}",
        hint="what this run hides can no longer be told for certain; make a new one",
    )
