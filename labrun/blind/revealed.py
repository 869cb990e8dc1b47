"""Opening the seal of a dry run, and the score of a diagnosis against what was hidden."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from labrun.blind.concealment import PARAMETER
from labrun.blind.seal import read_seal, write_seal
from labrun.errors import RecordingError
from labrun.store import PROVENANCE, RunFolder

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
        """Whether the hidden values of what was named lie inside the intervals that were stated."""
        found = []
        for one in self.revealed.hidden:
            for cause in self.stored.get("causes", []):
                if (cause["effect"], cause["site"]) == (one.effect, one.site):
                    found += _inside(one, cause)
        return found

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
            f"{run} is no run folder: it has no {PROVENANCE}", hint="labrun list shows the runs there are"
        )
    seal = read_seal(folder, RunFolder(folder).provenance)
    hidden = tuple(_hidden(one) for one in seal.hidden())
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
    truth = {(one.effect, one.site) for one in hidden}
    named, sets = [], []
    for cause in stored.get("causes", []):
        name = (cause["effect"], cause["site"])
        together = {name, *((one["effect"], one["site"]) for one in cause["indistinguishable_from"])}
        if cause["kind"] == "effect" or together & truth:
            named.append(name)
            sets.append(together)
    if not truth:
        return "false alarm" if named or stored["verdict"] == "not-in-library" else "right"
    if not named:
        unseen = all(_too_small(one, stored.get("candidates", [])) for one in hidden)
        return "too small to be seen" if unseen else "missed"
    found = {one for one in truth if any(one in together for together in sets)}
    useless = [together for together in sets if not together & truth]
    if found == truth and not useless:
        return "right" if truth == set(named) else "right, in a stated set"
    as_well = {
        (one["effect"], one["site"])
        for one in stored.get("candidates", [])
        if one["verdict"] == "indistinguishable"
    }
    return "right in part" if found or truth & as_well else "wrong"


def _too_small(one: Hidden, candidates: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether a diagnosis says that it could not have seen an effect of these sizes."""
    for candidate in candidates:
        if (candidate["effect"], candidate["site"]) != (one.effect, one.site):
            continue
        bounds = [
            (one.values[name], *bound["ci95"])
            for name, bound in candidate["upper_bound"].items()
            if name in one.values
        ]
        room = [low is not None and high is not None and low <= value <= high for value, low, high in bounds]
        return candidate["verdict"] == "not-visible" or (bool(room) and all(room))
    return False


def _hidden(one: Mapping[str, Any]) -> Hidden:
    values = {str(name): float(value) for name, value in one["values"].items()}
    return Hidden(one["effect"], one["site"], one["kind"], values, dict(one.get("units", {})))


def _inside(one: Hidden, cause: Mapping[str, Any]) -> list[str]:
    found = []
    for name, value in one.values.items():
        low, high = cause["values"].get(name, {}).get("ci95", (None, None))
        if low is not None and high is not None:
            where = "inside" if low <= value <= high else "outside"
            told = name.replace("_", " ")
            found.append(f"the hidden {told} lies {where} the 95 % interval that was stated")
    return found
