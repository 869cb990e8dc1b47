"""The next experiment: the trials that best separate what a diagnosis leaves."""

from collections.abc import Sequence
from pathlib import Path

from labrun.app.question import ask, find_data
from labrun.fit import Note, silent
from labrun.gap.next import Proposal, propose
from labrun.gap.next.proposal import require_experiment_place


def propose_next(
    target: str | Path,
    *,
    model: str | Path | None = None,
    more: Sequence[str | Path] = (),
    out: Path | None = None,
    seed: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> Proposal:
    """Propose the experiment that best separates what is left of a diagnosis.

    Parameters
    ----------
    target, more, model, seed
        As for `labrun.app.diagnose.diagnose`.
    out
        The experiment file to write; the proposal chooses a name in the workspace if None.

    Raises
    ------
    RequestError
        No such data or model, or nothing is left to separate.
    """
    if out is not None:
        require_experiment_place(out)
    results, workspace = Path(results), Path(workspace)
    folder = find_data(target, results)
    further = [find_data(one, results) for one in more]
    note(f"reading {folder}")
    question = ask(folder, model, further, workspace=workspace)
    return propose(folder, question, model=model, out=out, seed=seed or 0, workspace=workspace, note=note)
