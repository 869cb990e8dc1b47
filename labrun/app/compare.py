"""Compare a model as stated, or another run or recording, with data."""

import json
import math
import shutil
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labrun.app.kept import kept_folder, stem_of
from labrun.app.question import held_against, load_held, named_model
from labrun.errors import RequestError
from labrun.fit import (
    Comparison,
    Note,
    Pair,
    compared,
    paired,
    predicted_numbers,
    predictions,
    silent,
    told_apart,
)
from labrun.models import Model
from labrun.notebook import as_html
from labrun.report import comparison_figure, comparison_json, comparison_text
from labrun.store import all_runs, find_data, is_recording, open_run, read_recording, require_writable

_NOTEBOOK_WIDTH = 100


@dataclass(frozen=True, slots=True)
class StoredComparison:
    """A comparison and its files."""

    comparison: Comparison
    numbers: Path
    figure: Path

    @property
    def within(self) -> bool:
        """Tell whether no point is beyond the tolerance."""
        return self.comparison.within

    def _repr_html_(self) -> str:
        return as_html(self.to_text(_NOTEBOOK_WIDTH), self.figure)

    def to_text(self, width: int | None = None) -> str:
        """Return what ``labrun compare`` prints; the terminal's width if none is given."""
        width = shutil.get_terminal_size((100, 24)).columns if width is None else width
        return f"{comparison_text(self.comparison, width)}\n\n  figure: {self.figure}"

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun compare --json`` prints."""
        files = {"stored": str(self.numbers), "figure": str(self.figure)}
        return {**comparison_json(self.comparison), **files}


def compare(
    target: str | Path,
    other: str | Path | None = None,
    *,
    model: str | Path | None = None,
    tolerance: str | float | None = None,
    signals: Mapping[str, str] | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    note: Note = silent,
) -> StoredComparison:
    """Compare a model as stated, or another run or recording, with data; store the answer.

    Parameters
    ----------
    target
        The data: an experiment's name (its latest run), a run folder, a run.h5, or a recording's name or folder.
    other
        What is held against them, named likewise; else a model is. The same experiment's name again is the run before
        its latest. With ``design:`` and ``rig:`` before their names, what a design promised is held against what
        its rig gave, whichever is named first.
    model
        A model file, plugin or name: the workspace's own copy (``experiments/models/``) comes before the shipped one.
        Else what the experiment's ``[gap]`` or ``[fit]`` names; else the model.toml beside the recording.
    tolerance
        Greatest relative error that is accepted, as 0.15 or "15%".
    signals
        Which recorded channel is which input or output of the model; adds to the experiment's own.
    results
        Where runs are. The comparison of a run is kept in its folder, under ``compare/``; that of a recording in
        ``<results>/<experiment>/compare-<time>/``.

    Raises
    ------
    RequestError
        No such data or model; nothing that both have; a tolerance that is none; a ``design:`` that is none.
    FitError
        The model leaves the finite numbers.
    """
    results, workspace = Path(results), Path(workspace)
    accepted = _share(tolerance)
    target, other = _by_role(target, other, results)
    if other is not None and model is not None:
        raise RequestError(
            f"{other} and the model {model} cannot both be compared with {target}",
            hint="leave one of them out",
        )
    folder = find_data(target, results)
    against = None if other is None else find_data(other, results)
    if against is not None and against.resolve() == folder.resolve():
        against = _run_before(folder, target, other)
    kept = kept_folder(folder, results, "compare")
    require_writable(kept, "the comparison")
    note(f"reading {folder}")
    if against is None:
        given = None if model is None else named_model(model, workspace)
        simulated, wired = held_against(folder, given, workspace)
        comparison = _beside_model(folder, simulated, {**wired, **(signals or {})})
    else:
        with open_run(folder) as data, open_run(against) as held:
            pairs, notes = paired(data, held)
            comparison = _made(*told_apart(data, held), pairs, notes)
    comparison = replace(comparison, tolerance=accepted)
    note("drawing")
    from labrun.report import draw_figure, save_figure  # matplotlib

    kept.mkdir(parents=True, exist_ok=True)
    stem = stem_of(comparison.prediction)
    figure = save_figure(draw_figure(comparison_figure(comparison)), kept / f"{stem}.png")
    numbers = kept / f"{stem}.json"
    sources = {"source": str(folder), "against": str(against or simulated.source)}
    record = json.dumps({**comparison_json(comparison), **sources}, indent=2)
    numbers.write_text(record + "\n", encoding="utf-8")
    return StoredComparison(comparison, numbers, figure)


def _by_role(
    target: str | Path, other: str | Path | None, results: Path
) -> tuple[str | Path, str | Path | None]:
    """Return data and prediction named as ``rig:RUN`` and ``design:RUN``, in either order."""
    named = [(run, *_role(run)) for run in (target, other) if run is not None]
    roles = [role for _, role, _ in named]
    if not any(roles):
        return target, other
    if sorted(roles) != ["design", "rig"]:
        raise RequestError(
            f"{' '.join(str(run) for run, _, _ in named)}: expected one run of a design and one of a rig",
            hint="labrun compare design:swimmer rig:rowing",
        )
    names = {role: name for _, role, name in named}
    for role, name in names.items():
        folder = find_data(name, results)
        kind = (
            ""
            if is_recording(folder)
            else str(tomllib.loads(open_run(folder).experiment_toml).get("kind", ""))
        )
        if (kind == "design") != (role == "design"):
            mismatch = "is a design: it was simulated" if kind == "design" else "is not a design"
            raise RequestError(
                f"{role}:{name}: {folder} {mismatch}", hint="labrun compare design:swimmer rig:rowing"
            )
    return names["rig"], names["design"]


def _role(target: str | Path) -> tuple[str, str]:
    """Return the role and the name in ``ROLE:NAME``; the role is "" if absent."""
    role, colon, name = str(target).partition(":")
    return (role, name) if colon and role in ("design", "rig") else ("", str(target))


def _beside_model(folder: Path, model: Model, signals: Mapping[str, str]) -> Comparison:
    if not is_recording(folder):
        with open_run(folder) as data:
            numbers = predicted_numbers(data, model)
            if numbers is not None:
                return _made(data.name, _other_than(data.name, model.name), numbers, ())
    _require_signals(folder, model)
    dataset = load_held(folder, model, signals)
    pairs, notes = predictions(model, dataset)
    return _made(dataset.name, _other_than(dataset.name, model.name), pairs, (*dataset.notes, *notes))


def _require_signals(folder: Path, model: Model) -> None:
    """Raise RequestError if a model needs signals and the recording is a table of numbers."""
    if not model.inputs or not is_recording(folder):
        return
    recording = read_recording(folder)
    if recording.inputs or any(len(trial.time_s) > 1 for trial in recording.trials):
        return
    driven = ", ".join(signal.name for signal in model.inputs)
    raise RequestError(
        f"{folder.name} is a table of numbers, and {model.name} predicts signals from {driven}, which it does not have",
        hint=f"compare a run with the table: labrun compare RUN {folder.name}; or name a model that predicts "
        f"{', '.join(output.name for output in recording.outputs)} from conditions alone",
    )


def _run_before(folder: Path, target: str | Path, other: str | Path | None) -> Path:
    """Return the second-latest run of an experiment."""
    named = str(target) == str(other) == folder.parent.name and not is_recording(folder)
    runs = [run for run in all_runs(folder.parent.parent) if run.parent == folder.parent] if named else []
    earlier = runs[: runs.index(folder)] if folder in runs else []
    if not earlier:
        raise RequestError(
            f"{target} and {other} are the same data, {folder}",
            hint="an experiment's name, given twice, compares its latest run with the one before",
        )
    return earlier[-1]


def _other_than(data: str, model: str) -> str:
    """Return the name of a model, marked if the data have the same name."""
    return f"the model {model}" if model == data else model


def _made(data: str, prediction: str, pairs: Sequence[Pair], notes: tuple[str, ...]) -> Comparison:
    channel = pairs[0].channel
    trials = sum(pair.trials for pair in pairs if pair.channel == channel)
    return Comparison(data, prediction, tuple(pairs), compared(pairs), trials, notes=notes)


def _share(tolerance: str | float | None) -> float | None:
    """Return a tolerance as a fraction."""
    if tolerance is None:
        return None
    text = str(tolerance).strip()
    try:
        share = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share < math.inf:
        raise RequestError(
            f"{text!r} is not a valid tolerance", hint="write a share of what is measured, such as 15%"
        )
    if share > 1.0 and not text.endswith("%"):
        raise RequestError(
            f"a tolerance of {text} is {100 * share:g} %",
            hint=f"write {text}% if you mean per cent, {100 * share:g}% if you mean that",
        )
    return share
