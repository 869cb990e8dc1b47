"""The state of a search after each generation: to look at, to draw, and to prove that a resumed run repeats it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labrun.errors import StoreError
from labrun.store import replace_durably, saving

_EXPLAINED = ("restart", "population", "mean", "sigma", "covariance", "path_sigma", "path_c", "candidates")


def generation_file(folder: Path, generation: int) -> Path:
    """Return where a generation's state stands; generations count from 1."""
    return folder / f"generation-{generation:06d}.json"


def keep_generation(folder: Path, generation: int, state: Mapping[str, Any]) -> None:
    """Store a generation's state, or check that it equals the one stored already.

    Parameters
    ----------
    folder
        The run's ``search`` folder; made if absent.
    state
        JSON-ready values.

    Raises
    ------
    StoreError
        A state of this generation is stored and differs in any bit: the search that is being replayed is not
        the one that was interrupted.
    """
    path = generation_file(folder, generation)
    text = json.dumps(state, allow_nan=False)
    if path.is_file():
        _compare(path, json.loads(text))
        return
    with saving(f"the state of generation {generation}", folder.parent):
        folder.mkdir(parents=True, exist_ok=True)
        replace_durably(path, text.encode())


def read_generations(folder: Path) -> list[dict[str, Any]]:
    """Return the states of all generations of a run, in order; empty for a run without a search."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("generation-*.json"))]


def _compare(path: Path, state: Mapping[str, Any]) -> None:
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise StoreError(
            f"{path} cannot be read: {error}", hint="delete that one file and resume: it is computed again"
        ) from error
    if stored == state:
        return
    differing = [key for key in state if stored.get(key) != state[key]]
    key = next((key for key in _EXPLAINED if key in differing), differing[0] if differing else "keys")
    raise StoreError(
        f"the resumed search does not repeat the stored one: {key} of generation {state.get('generation')} differs "
        f"from {path}",
        hint="same labrun, numpy and cma as in provenance.json? The trials are safe; a new run starts a new search",
    )
