"""Opening the seal of a dry run that hid something: what it was, and whether anyone had looked before."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.errors import RecordingError
from labrun.store.folder import PROVENANCE, RunFolder
from labrun.store.seal import Seal, note_opening, read_seal, write_seal

__all__ = ["Hidden", "Revealed", "read_seal", "reveal", "seal"]


@dataclass(frozen=True, slots=True)
class Hidden:
    """One effect or parameter that was hidden; its values are in the units of `units`."""

    effect: str
    site: str
    kind: str
    values: Mapping[str, float]
    units: Mapping[str, str]

    def __str__(self) -> str:
        values = ", ".join(
            f"{name} = {value:.4g}{'' if self.units.get(name, '1') == '1' else ' ' + self.units[name]}"
            for name, value in self.values.items()
        )
        if self.kind == "parameter":
            return f"parameter {values}"
        return f"{self.effect} at {self.site}" + (f": {values}" if values else "")


@dataclass(frozen=True, slots=True)
class Revealed:
    """What a seal held; the hash held, or there would be no such object.

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
        """Return it JSON-ready."""
        return {
            "run": str(self.run),
            "hidden": [
                {"effect": one.effect, "site": one.site, "kind": one.kind, "values": dict(one.values)}
                for one in self.hidden
            ],
            "sealed_at": self.sealed_at,
            "sha256": self.sha256,
            "hash_ok": True,
            "opened_before": list(self.opened_before),
        }

    def to_text(self) -> str:
        """Return it as a person reads it."""
        lines = [f"hidden    {one}" for one in self.hidden] or ["hidden    nothing"]
        lines.append(f"sealed    {self.sealed_at}, sha256 {self.sha256[:16]}, unbroken")
        lines.append(
            f"opened    before, {len(self.opened_before)} times, first {self.opened_before[0]}"
            if self.opened_before
            else "opened    never before"
        )
        return "\n".join(lines)


def seal(run: Path, hidden: Sequence[Mapping[str, Any]], *, salt: str | None = None) -> Seal:
    """Seal an answer into a folder, for example one case of a withheld check.

    Parameters
    ----------
    run
        The folder.
    hidden
        What is hidden: ``effect``, ``site``, ``kind``, ``values`` (SI) and ``units`` of each.
    salt
        Drawn if None.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    made = Seal.of(hidden, salt)
    write_seal(run, made)
    return made


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
            f"{run} is no run folder: it has no {PROVENANCE}", hint="labrun list shows the runs there are"
        )
    found = read_seal(folder, RunFolder(folder).provenance)
    hidden = tuple(_hidden(one) for one in found.hidden())
    note_opening(folder, found)
    return Revealed(folder, hidden, found.sealed_at, found.sha256, found.opened_at)


def _hidden(one: Mapping[str, Any]) -> Hidden:
    values = {str(name): float(value) for name, value in one["values"].items()}
    return Hidden(one["effect"], one["site"], one["kind"], values, dict(one.get("units", {})))
