"""Run a design: simulate candidates on all workers, perturb the winner, and write its files."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from labrun.app.carry_out import (
    Answer,
    finish,
    interruptible,
    require_answer,
    resumable,
    source_of,
)
from labrun.design import (
    MADE,
    Candidates,
    Simulated,
    SimulationLimitError,
    Simulator,
    dimensions_csv,
    drawing_of,
    model_text,
    require_simulable,
    written_experiment,
)
from labrun.errors import PlanError, RequestError
from labrun.experiment import (
    Experiment,
    LoadedExperiment,
    find_experiment,
    find_model_file,
    load_experiment,
    load_named,
    loads_experiment,
    shipped_experiments,
)
from labrun.interrupts import handled
from labrun.objectives import make_objective
from labrun.report import counted
from labrun.runner import Plan, Progress, SearchSpace, SilentProgress
from labrun.search import Best, RunResult, honest_best, read_generations, resume_line, search_by_cmaes
from labrun.store import RunFolder, collect, replace_durably, saving
from labrun.workers import Pool, cores, pool

_PROBES = 4096
_NEAR = 0.01
"""A variable closer to an end of its range than this share of it stands at that end."""


def design(
    experiment: str | Path | LoadedExperiment,
    *,
    dry_run: bool = False,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    limit: int | None = None,
    results: str | Path = "results",
    workspace: str | Path = ".",
    progress: Progress | None = None,
    draw: bool = True,
) -> RunResult:
    """Search geometry and gait together on a simulation, perturb the winner, and write its files.

    The result is the same for any number of workers.

    Parameters
    ----------
    experiment
        Its name, the path of its TOML file, or one that is loaded already, of kind "design".
    dry_run
        Must be said: a design is simulated, always.
    overrides
        Keys of the file to replace.
    seed
        Of all randomness; drawn if None, and stored with the run.
    workers
        Processes to compute with; one per core if None.
    cluster
        Address of a Dask scheduler to compute on instead.
    limit
        Stop, resumably, before the generation after so many candidates are simulated.
    results, workspace
        Where runs are, and where experiments are looked for and written.
    progress
        Who is told how it goes; nobody if None.
    draw
        Whether the finished run gets its picture.

    Raises
    ------
    RequestError
        The request does not hold, or bounds and constraints exclude each other; nothing was written.
    ExperimentError, Interrupted
        It failed, or was interrupted; the hint says how to go on.
    """
    loaded = experiment
    if not isinstance(loaded, LoadedExperiment):
        with interruptible():
            loaded = load_named(str(experiment), Path(workspace), overrides, kind="design")
    if not dry_run:
        raise RequestError(
            f"{loaded.name} is a design: its trials are simulations, and nothing of it runs on a bench",
            hint=f"labrun design {loaded.name} --dry-run",
        )
    if seed is None:
        seed = int(np.random.default_rng().integers(2**32))
    with (
        handled() as interrupts,
        interrupts.held(),
        SilentProgress() if progress is None else progress as reporter,
    ):
        reporter.phase("checking the design")
        with interruptible():
            simulator = simulator_of(loaded.experiment, loaded.path)
            share = require_simulable(simulator)
            texts = _templates(loaded.experiment, loaded.path, Path(workspace))
        origin = {
            **collect(loaded.path.resolve().parent, seed=seed),
            **source_of(loaded.path),
            "dry_run": True,
            "emulated": False,
        }
        folder = RunFolder.create(Path(results), loaded.name, loaded.resolved_toml, origin)
        for name, text in texts.items():
            replace_durably(folder.path / f"template-{name}.toml", text.encode())
        reporter.note(f"{100 * share:.2g} % of the space satisfies the constraints known beforehand")
        return go_on(
            simulator, folder, seed=seed, workers=workers, cluster=cluster, limit=limit,
            workspace=Path(workspace), progress=reporter, draw=draw,
        )  # fmt: skip


def design_plan(loaded: LoadedExperiment) -> Plan:
    """Return the plan of a design, of which some points have been simulated.

    Raises
    ------
    RequestError
        Bounds and constraints exclude each other, or file and model do not fit together.
    """
    simulator = simulator_of(loaded.experiment, loaded.path)
    share = require_simulable(simulator)
    _templates(loaded.experiment, loaded.path, Path())
    leaders, search = loaded.experiment.leaders, simulator.design
    candidates = search.stop.iterations * search.population_size
    return Plan(
        conditions=candidates,
        trials=(leaders.count + 1) * leaders.repeats,
        trials_at_most=(leaders.count + 1) * leaders.repeats,
        time_s=0.0,
        time_at_most_s=0.0,
        settle_s=0.0,
        disk_bytes=0,
        disk_kept_bytes=0,
        peaks=(),
        rates_hz={},
        space=SearchSpace(_PROBES, share, (), ()),
        notes=(f"a design: at most {candidates:,} candidates are simulated, then copies of the leaders",),
    )


def simulator_of(experiment: Experiment, relative_to: Path) -> Simulator:
    """Return the simulator of the candidates of the experiment file at `beside`."""
    if experiment.design is None:
        raise PlanError("the experiment has no table [design]", hint='it needs one with kind = "design"')
    given = experiment.design.model
    path = find_model_file(given, relative_to, Path())
    return Simulator(experiment, given if path is None else str(path.resolve()))


def go_on(
    simulator: Simulator,
    folder: RunFolder,
    *,
    seed: int,
    workers: int | None,
    cluster: str | None,
    limit: int | None,
    workspace: Path,
    progress: Progress,
    draw: bool = True,
) -> RunResult:
    """Search, confirm the best and write its files; stored generations are not simulated again."""
    experiment = simulator.experiment
    goal = experiment.goal
    if goal is None:
        raise PlanError("a design needs an objective with a goal")
    name, direction = goal
    search = folder.path / "search"
    with handled() as interrupts, folder.lock(), resumable(folder, stopped=""), interrupts.raising():
        with _opened(workers, cluster) as executor:
            candidates = Candidates(
                simulator, folder, executor,
                seed=seed, progress=progress, generations=read_generations(search), limit=limit,
            )  # fmt: skip
            try:
                searched = search_by_cmaes(
                    experiment, candidates, search, feasibility=candidates, seed=seed, progress=progress
                )
            except SimulationLimitError:
                folder.journal.append("limit-reached", limit=limit)
                simulated = counted(candidates.simulated, "candidate")
                progress.note(f"stopped after {simulated}; to continue: {resume_line(folder.path)}")
                return RunResult(folder.path, 0, 0, 0, None, None, finished=False)
            progress.phase("copies of the leaders, as they may be built")
            best = honest_best(
                candidates, searched.measured, objective=name, goal=direction, unit=_unit(simulator, name),
                leaders=experiment.leaders,
            )  # fmt: skip
        more: list[str] = []
        if best is not None:
            nominal = simulator([best.parameters], keep=True)[0]
            more = _told(simulator, best, nominal, candidates)
            more += _handed_on(simulator, folder, best, nominal, workspace, progress)
        answer = Answer(best, (searched.verdict,), more=tuple(more))
        return require_answer(finish(folder, answer, progress, draw), experiment)


@contextmanager
def _opened(workers: int | None, cluster: str | None) -> Iterator[Pool | None]:
    """Return the workers, or None if this process computes alone."""
    count = cores() if workers is None else workers
    if cluster is None and count == 1:
        yield None
        return
    with pool(count, cluster) as executor:
        yield executor


def _unit(simulator: Simulator, objective: str) -> str:
    table = simulator.experiment.objectives[objective]
    units = {output.name: output.unit for output in simulator.loaded.outputs}
    return make_objective(objective, table).unit(units.get((table.channel or "").partition(".")[2], "1"))


def _told(simulator: Simulator, best: Best, nominal: Simulated, candidates: Candidates) -> list[str]:
    """Return the active constraints of the design, and the results of its copies."""
    lines = (
        [
            f"nominal   {best.objective_name} = {nominal.objectives[best.objective_name]:.4g} {best.unit} "
            "with every dimension exact"
        ]
        if nominal.objectives
        else []
    )
    for name, variable in simulator.design.variables.items():
        value, near = float(best.parameters[name]), _NEAR * (variable.stop - variable.start)
        for end, which in ((variable.start, "lower"), (variable.stop, "upper")):
            if abs(value - end) <= near:
                lines.append(f"active    {name} at its {which} bound, {value:.4g} of {end:g}")
    for margin in nominal.margins:
        if margin.value is None or margin.bound is None:
            lines.append(f"holds     {margin.text}")
        else:
            word = "active" if margin.active else "holds"
            of = f" of {margin.bound:.4g}" if margin.bound else ""
            lines.append(f"{word:<9} {margin.text}: {margin.value:.4g}{of}")
    broken = Counter(candidates.broken.get("confirm", ()))
    for text, count in broken.most_common():
        lines.append(f"copies    {count} of {best.trials} within the tolerances break {text}")
    return lines


def _handed_on(
    simulator: Simulator,
    folder: RunFolder,
    best: Best,
    nominal: Simulated,
    workspace: Path,
    progress: Progress,
) -> list[str]:
    """Write drawing, dimensions, model and experiments; return lines with their paths."""
    experiment, design_table, values = simulator.experiment, simulator.design, best.parameters
    run = folder.path
    progress.phase("writing the design")
    written: list[tuple[str, Path]] = []
    with saving("the design", run):
        replace_durably(
            run / "dimensions.csv", dimensions_csv(design_table, values, experiment.units).encode()
        )
        written.append(("sheet", run / "dimensions.csv"))
        drawing = drawing_of(design_table, values)
        if drawing is not None:
            from labrun.report import as_svg, draw_design, save_figure  # matplotlib

            figure = draw_design(drawing, experiment.units, experiment.title)
            replace_durably(run / "drawing.svg", as_svg(figure))
            save_figure(draw_design(drawing, experiment.units, experiment.title), run / "drawing.png")
            written.append(("drawing", run / "drawing.svg"))
        replace_durably(run / "model.toml", model_text(simulator, values, run=str(run)).encode())
        written.append(("model", run / "model.toml"))
        numbers = {
            "variables": dict(values),
            "parameters": simulator.parameters(values),
            "objectives": dict(nominal.objectives),
            "constraints": [
                {"text": margin.text, "value": margin.value, "bound": margin.bound, "active": margin.active}
                for margin in nominal.margins
            ],
        }
        replace_durably(run / "design.json", (json.dumps(numbers, indent=2) + "\n").encode())
    for name, table in design_table.writes.items():
        template = (run / f"template-{name}.toml").read_text(encoding="utf-8")
        modelled = "model.toml"
        if table.model is not None:
            modelled = f"{name}-model.toml"
            own = model_text(simulator, values, run=str(run), model=table.model)
            replace_durably(run / modelled, own.encode())
        text = written_experiment(
            table,
            template,
            f"design.writes.{name}",
            values,
            title=experiment.title,
            run=str(run),
            model=str(run / modelled),
        )
        replace_durably(run / f"{name}.toml", text.encode())
        target, yours = _place_of(name, workspace)
        try:
            loads_experiment(text, name, relative_to=target)
        except RequestError as error:
            progress.note(
                f"{target} stays as it is: with the values of this design it would be refused; correct "
                f"{run / f'{name}.toml'}, or the ranges in its template: {error}"
            )
            written.append(("rig", run / f"{name}.toml"))
            continue
        if yours:
            progress.note(
                f"{target} was edited and is kept; the experiment of this design is {run / f'{name}.toml'}"
            )
            written.append(("rig", run / f"{name}.toml"))
            continue
        with saving(str(target), workspace):
            replace_durably(target, text.encode())
        written.append(("rig", target))
    return [f"{what:<9} {path}" for what, path in written]


def _place_of(name: str, workspace: Path) -> tuple[Path, bool]:
    """Return the path of an experiment in the workspace, and whether a user edited it.

    What ``labrun init`` copied and nobody changed is no one's: the design takes its place.
    """
    places = [workspace / "experiments" / f"{name}.toml", workspace / f"{name}.toml"]
    target = next((location for location in places if location.is_file()), places[-1])
    if not target.is_file():
        return target, False
    text, shipped = target.read_text(encoding="utf-8"), shipped_experiments() / f"{name}.toml"
    copied = shipped.is_file() and text == shipped.read_text(encoding="utf-8")
    return target, not (copied or text.startswith(MADE))


def _templates(experiment: Experiment, relative_to: Path, workspace: Path) -> dict[str, str]:
    """Return the checked text of each experiment to be written for the rig of the design."""
    table = experiment.design
    texts: dict[str, str] = {}
    for name, written in ({} if table is None else table.writes).items():
        near = relative_to.parent / f"{written.template}.toml"
        path = near if near.is_file() else find_experiment(written.template, workspace)
        try:
            load_experiment(path)
        except RequestError as error:
            raise RequestError(f"design.writes.{name}.template: {error}", hint=error.hint) from error
        texts[name] = path.read_text(encoding="utf-8")
        assert table is not None  # noqa: S101  (there would be nothing to write)
        start = {variable_name: float(variable.start) for variable_name, variable in table.variables.items()}
        written_experiment(
            written,
            texts[name],
            f"design.writes.{name}",
            start,
            title=experiment.title,
            run="",
            model=table.model,
        )
    return texts
