"""What a diagnosis said beside what was hidden."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from labrun.gap.diagnosis import Estimate, Name
from labrun.report.gap_store import read_stored
from labrun.report.text import estimate_words, listed, number, spaced

if TYPE_CHECKING:
    from labrun.gap.seal import Hidden, Revealed

Score = Literal["right", "right, in a stated set", "right in part", "missed", "false alarm", "wrong"]


@dataclass(frozen=True)
class Compared:
    """The stored verdict of a run beside what its dry run hid.

    Attributes
    ----------
    revealed
        What was hidden, from the seal.
    stored
        The diagnosis, as ``--json`` printed it.
    """

    revealed: "Revealed"
    stored: Mapping[str, Any]

    @property
    def score(self) -> Score:
        """How the two agree: by effect and site, whatever the sizes."""
        return score(self.stored, self.revealed.hidden)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap reveal --json`` prints."""
        return {
            **self.revealed.to_json(),
            "score": self.score,
            "sizes": self.sizes,
            "verdict": self.stored["verdict"],
            "causes": self.stored.get("causes", []),
        }

    def to_text(self) -> str:
        """Return verdict and truth under each other, then what the seal says of itself."""
        own = self.revealed.to_text().splitlines()
        hidden = [line for line in own if line.startswith("hidden")]
        sizes = [f"sizes     {text}" for text in self.sizes]
        rest = [line for line in own if line not in hidden]
        return "\n".join(
            [f"said      {_said(self.stored)}", *hidden, f"score     {self.score}", *sizes, *rest]
        )

    @property
    def sizes(self) -> list[str]:
        """Whether the hidden values of what was named lie inside the intervals that were stated."""
        found = []
        for one in self.revealed.hidden:
            for cause in self.stored.get("causes", []):
                if (cause["effect"], cause["site"]) == (one.effect, one.site):
                    found += _inside(one, cause)
        return found


def compare(run: Path) -> Compared:
    """Open the seal of a run that was diagnosed.

    Raises
    ------
    RequestError
        There is no diagnosis: the seal stays closed.
    RecordingError
        Nothing is sealed, or the seal is broken.
    """
    from labrun.gap.seal import reveal

    stored = read_stored(run)
    return Compared(reveal(run), stored)


def score(stored: Mapping[str, Any], hidden: "Sequence[Hidden]") -> Score:
    """Return how a diagnosis agrees with what was hidden, by effect and site.

    A parameter among the causes is neither right nor wrong beside an effect: what a model states may be off as well. It
    counts where it was hidden itself, or where what was hidden is stated as its rival.
    """
    truth = {(one.effect, one.site) for one in hidden}
    named, sets = [], []
    for cause in stored.get("causes", []):
        name = (cause["effect"], cause["site"])
        together = {name, *((one["effect"], one["site"]) for one in cause["indistinguishable_from"])}
        if cause["kind"] == "effect" or together & truth:
            named.append(name)
            sets.append(together)
    if not named:
        return "missed" if truth else "right"
    if not truth:
        return "false alarm"
    found = {one for one in truth if any(one in together for together in sets)}
    useless = [together for together in sets if not together & truth]
    if found == truth and not useless:
        return "right" if truth == set(named) else "right, in a stated set"
    return "right in part" if found else "wrong"


def _inside(one: "Hidden", cause: Mapping[str, Any]) -> list[str]:
    found = []
    for name, value in one.values.items():
        low, high = cause["values"].get(name, {}).get("ci95", (None, None))
        if low is not None and high is not None:
            where = "inside" if low <= value <= high else "outside"
            found.append(f"the hidden {spaced(name)} lies {where} the 95 % interval that was stated")
    return found


def _said(stored: Mapping[str, Any]) -> str:
    causes = stored.get("causes", [])
    if not causes:
        return {"no-gap": "no gap", "not-in-library": "something that is not in the library"}.get(
            str(stored["verdict"]), str(stored["verdict"])
        )
    return "; ".join(_cause(cause) for cause in causes)


def _cause(cause: Mapping[str, Any]) -> str:
    name = str(Name(cause["effect"], cause["site"], cause["kind"]))
    others = [str(Name(one["effect"], one["site"], one["kind"])) for one in cause["indistinguishable_from"]]
    if others:
        name += f" (or {listed(others, 'or')})"
    values = ", ".join(_value(key, value) for key, value in cause["values"].items())
    return f"{name}: {values}" if values else name


def _value(name: str, value: Mapping[str, Any]) -> str:
    low, high = value["ci95"]
    if value["value"] is None or low is None or high is None:
        return f"{spaced(name)} = {'not known' if value['value'] is None else number(value['value'])}"
    estimate = Estimate(value["value"], low, high, value["unit"])
    return f"{name} = {estimate_words(estimate, prefix=False)}"
