"""Seals: what a dry run hides, kept with the run where nobody reads it by accident; opened, and scored against.

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
from typing import Any, Literal

from labrun.blind.answer import Answer, CauseName
from labrun.errors import RecordingError
from labrun.store import PROVENANCE, RunFolder, replace_durably, saving

PARAMETER = "parameter"
"""Kind of what is hidden that is no effect: a parameter's true value."""
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
        return [dict(effect) for effect in hidden]

    def opened(self) -> "Seal":
        """Return the seal with a note that it is opened now."""
        return replace(self, opened_at=(*self.opened_at, _now()))


def write_seal(run: Path, seal: Seal) -> None:
    """Write a seal into a run folder.

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
    """Return a command line without the hidden effects."""
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
        hint="what this run hides is no longer certain; make a new run",
    )


Score = Literal[
    "right", "right, in a stated set", "right in part", "too small to be seen", "missed", "false alarm", "wrong",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect or parameter that was hidden; its values are in the units of `units`."""

    effect: str
    site: str
    kind: str
    values: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def name(self) -> CauseName:
        """What is scored: the effect at its site, or the parameter."""
        return CauseName(effect=self.effect, site="" if self.kind == PARAMETER else self.site)

    def __str__(self) -> str:
        values = ", ".join(
            f"{name} = {value:.4g}{'' if self.units.get(name, '1') == '1' else ' ' + self.units[name]}"
            for name, value in self.values.items()
        )
        if self.kind == PARAMETER:
            return f"parameter {values}"
        return f"{self.effect} at {self.site}" + (f": {values}" if values else "")


@dataclass(frozen=True, slots=True)
class Revealed:
    """The contents of a seal whose hash was verified.

    Attributes
    ----------
    run
        The run's folder.
    hidden
        What was hidden; empty where nothing was.
    sealed_at
        When, UTC.
    sha256
        The hash that was printed when the run began.
    opened_before
        When it had been opened before this time; empty the first time.
    """

    run: Path
    hidden: tuple[Hidden, ...]
    sealed_at: str
    sha256: str
    opened_before: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the fields JSON-ready."""
        return {
            "run": str(self.run),
            "hidden": [
                {
                    "effect": effect.effect,
                    "site": effect.site,
                    "kind": effect.kind,
                    "values": dict(effect.values),
                }
                for effect in self.hidden
            ],
            "sealed_at": self.sealed_at,
            "sha256": self.sha256,
            "hash_ok": True,
            "opened_before": list(self.opened_before),
        }


@dataclass(frozen=True)
class Compared:
    """A diagnosis beside what was hidden.

    Attributes
    ----------
    revealed
        What was hidden, from the seal.
    stored
        The diagnosis, as ``labrun gap diagnose --json`` prints it.
    """

    revealed: Revealed
    stored: Mapping[str, Any]

    @property
    def score(self) -> Score:
        """How the two agree: by effect and site, whatever the sizes."""
        return score(self.stored, self.revealed.hidden)

    @property
    def sizes(self) -> list[str]:
        """Tell whether the hidden values of what was named lie inside the intervals that were stated."""
        sizes = []
        for effect in self.revealed.hidden:
            for cause in self.stored.get("causes", []):
                if (cause["effect"], cause["site"]) == (effect.effect, effect.site):
                    sizes += _inside(effect, cause)
        return sizes

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap reveal --json`` prints."""
        return {
            **self.revealed.to_json(),
            "score": self.score,
            "sizes": self.sizes,
            "verdict": self.stored["verdict"],
            "causes": self.stored.get("causes", []),
        }


def reveal(run: Path) -> Revealed:
    """Open the seal of a run, and write down that it was opened.

    Parameters
    ----------
    run
        The run's folder, or the run.h5 in it.

    Raises
    ------
    RecordingError
        No run, a run that hides nothing, a seal that is gone, or one that was changed after the run began.
    StoreError
        The opening cannot be written down.
    """
    folder = run.parent if run.is_file() else run
    if not (folder / PROVENANCE).is_file():
        raise RecordingError(
            f"{run} is not a run folder: it lacks {PROVENANCE}", hint="labrun list shows the runs there are"
        )
    seal = read_seal(folder, RunFolder(folder).provenance)
    hidden = tuple(_hidden(effect) for effect in seal.hidden())
    write_seal(folder, seal.opened())
    return Revealed(folder, hidden, seal.sealed_at, seal.sha256, seal.opened_at)


def score(stored: Mapping[str, Any], hidden: Sequence[Hidden]) -> Score:
    """Return how a diagnosis agrees with what was hidden, by effect and site.

    Where it names nothing, what is hidden is too small to be seen if the diagnosis itself says so: that it is not
    visible, or smaller than the largest size that the data leave room for.

    A parameter among the causes is neither right nor wrong beside an effect: what a model states may be off as well. It
    counts where it was hidden itself, or where what was hidden is stated as its rival.

    Two are told of effects that these data cannot tell apart. A third one that stands in the list of candidates as
    explaining them as well is right in part.
    """
    truth = {item.name for item in hidden}
    answer = Answer.of_diagnosis(stored)
    causes = [cause for cause in answer.causes if cause.site or not truth.isdisjoint(cause.members)]
    if not truth:
        return "false alarm" if causes else "right"
    if not causes:
        unseen = all(_too_small(item, stored.get("candidates", [])) for item in hidden)
        return "too small to be seen" if unseen else "missed"
    named = truth & {member for cause in causes for member in cause.members}
    if named == truth and all(not truth.isdisjoint(cause.members) for cause in causes):
        return "right" if truth == {cause.name for cause in causes} else "right, in a stated set"
    as_well = {
        CauseName.of_diagnosis(candidate)
        for candidate in stored.get("candidates", [])
        if candidate["verdict"] == "rival"
    }
    return "right in part" if named or truth & as_well else "wrong"


def _too_small(hidden: Hidden, candidates: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether a diagnosis says that it could not have seen an effect of these sizes."""
    for candidate in candidates:
        if (candidate["effect"], candidate["site"]) != (hidden.effect, hidden.site):
            continue
        bounds = [
            (hidden.values[name], *bound["ci95"])
            for name, bound in candidate["upper_bound"].items()
            if name in hidden.values
        ]
        room = [low is not None and high is not None and low <= value <= high for value, low, high in bounds]
        return candidate["verdict"] == "not-visible" or (bool(room) and all(room))
    return False


def _hidden(effect: Mapping[str, Any]) -> Hidden:
    values = {str(name): float(value) for name, value in effect["values"].items()}
    return Hidden(effect["effect"], effect["site"], effect["kind"], values, dict(effect.get("units", {})))


def _inside(hidden: Hidden, cause: Mapping[str, Any]) -> list[str]:
    factor = _to_reference_of(hidden, cause)
    sentences = []
    for name, value in hidden.values.items():
        low, high = cause["values"].get(name, {}).get("ci95", (None, None))
        if low is None or high is None:
            continue
        scaled = value / factor if name == "coefficient" else value
        where = "inside" if low <= scaled <= high else "outside"
        at = "" if factor == 1.0 or name != "coefficient" else ", at the same reference,"
        sentences.append(
            f"the hidden {name.replace('_', ' ')}{at} lies {where} the 95 % interval that was stated"
        )
    return sentences


def _to_reference_of(hidden: Hidden, cause: Mapping[str, Any]) -> float:
    """Return the factor from a coefficient at the cause's reference to the same law's at the hidden reference.

    A law ``c x^n (x / reference)^(exponent - n)`` has another coefficient at another reference wherever its exponent is
    not the usual n. 1 where either has no reference.
    """
    from labrun.effects import effects

    stated = {name: number["value"] for name, number in cause.get("refers_to", {}).items()}
    stated |= {name: number["value"] for name, number in cause["values"].items()}
    if not all("reference" in values for values in (hidden.values, stated)):
        return 1.0
    library = [effect for effect in effects() if effect.id == hidden.effect]
    usual = [
        item.starts[0]
        for effect in library
        for item in effect.parameters
        if item.name == "exponent" and item.held
    ]
    exponent = hidden.values.get("exponent", stated.get("exponent"))
    if not usual or exponent is None:
        return 1.0
    return float((hidden.values["reference"] / stated["reference"]) ** (exponent - usual[0]))
