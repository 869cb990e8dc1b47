"""How often the 95 % intervals of every rig's fit hold what the simulated bench is set to.

    python benchmarks/fit_coverage.py                       # ten seeds of every experiment that declares a fit
    python benchmarks/fit_coverage.py --only hinge --seeds 3
    python benchmarks/fit_coverage.py --store runs.jsonl    # keeps what is done: a second call goes on from there
    python benchmarks/fit_coverage.py --store runs.jsonl --table docs/development/fit-coverage.md

Each seed is ``labrun run NAME --dry-run --seed S`` and ``labrun fit NAME``, on plans that are reduced where a fit of
the whole plan takes minutes (`Case.overrides`). The truth of a parameter is, in this order: what the scene's `truth()`
tells of the bench as it stands after the run (a specimen that was mounted once); what its population is set to, where
specimens and mountings scatter within the run; and the same fit to a run without noise, where a fit tells something
that is no parameter of the scene, as a crossing of two curves.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from labrun_plugins.rigs.beam.scene import (
    BUCKLED_SHARE,
    HYSTERESIS,
    LIMITS_N_M,
    STIFFNESS_N_M,
)
from labrun_plugins.rigs.hinge.dimensions import damping, stiffness
from labrun_plugins.rigs.hinge.scene import HingeBench
from labrun_plugins.rigs.hinge_life.scene import MEDIANS, SHAPE
from labrun_plugins.rigs.six_bar.scene import SixBar
from labrun_plugins.rigs.tensile.scene import LAYUPS, YIELD_PA, YOUNG_PA
from labrun_plugins.simulated.bench import Bench

import labrun
from labrun.models import load_model, simulate

Truth = Mapping[str, float]
LEVEL = 0.95


@dataclass(frozen=True)
class Case:
    """One experiment and its fit.

    Attributes
    ----------
    truth
        Parameters that are compared, from the scene's own `truth()` after the run where `scene` is given.
    scene
        Class whose instance is asked.
    overrides
        What of the file is changed for the run.
    twin
        Changes of the run whose fit is the truth, instead of `truth`.
    note
        What the truth is, for the table.
    """

    note: str
    truth: Callable[[Mapping[str, Any]], Truth] = dict
    scene: type[Bench] | None = None
    overrides: Sequence[str] = ()
    twin: Sequence[str] = ()
    starts: int | None = None
    reduced: str = ""
    experiment: str = ""
    method: str | None = None
    fit: Mapping[str, Any] = field(default_factory=dict)


def _tensile(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    return {"young": 1e-6 * YOUNG_PA, "yield_stress": 1e-6 * YIELD_PA, "toe_strain": 0.25}


def _two_layups(message: Mapping[str, Any]) -> Truth:
    own = {f"{name}_{layup}": value for layup in LAYUPS for name, value in _tensile(message).items()}
    return own | {f"fracture_load_{layup}": specimen.breaks_n for layup, specimen in LAYUPS.items()}


def _beam(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    limit, stiff = LIMITS_N_M["long"][0], STIFFNESS_N_M["long"]
    return {
        "stiffness": stiff,
        "limit": limit,
        "buckled_stiffness": BUCKLED_SHARE * stiff,
        "loop": HYSTERESIS["long"] * limit,
    }


def _limits(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    return {f"{sense}_limit": LIMITS_N_M["long"][index] for index, sense in enumerate(("equal", "opposite"))}


def _hinge(message: Mapping[str, Any]) -> Truth:
    return {"stiffness": message["parameters"]["stiffness"]}


def _hinge_tests(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    return {"stiffness": 0.0686, "damping": 2.886e-4}


def _map(name: str, size_mm: Sequence[float], asked: Callable[[float], float]) -> dict[str, float]:
    """Return the coefficients of the published map along one size, m: it is a parabola there."""
    sizes = 1e-3 * np.array(size_mm)
    square, linear, constant = np.polyfit(sizes, [asked(size) for size in sizes], 2)
    letter, quantity = name[-1], name[0]
    return {f"{quantity}_{letter}2": square, f"{quantity}_{letter}": linear, f"{quantity}_0": constant}


def _width_map(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    sizes = (20, 30, 40, 50, 60)
    return _map("k_w", sizes, lambda w: stiffness(w, 1.75e-3)) | _map(
        "b_w", sizes, lambda w: damping(43e-4, w, 1.75e-3)
    )


def _length_map(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    sizes = (1, 1.75, 2.5, 3.25, 4)
    return _map("k_l", sizes, lambda length: stiffness(50e-3, length)) | _map(
        "b_l", sizes, lambda length: damping(43e-4, 50e-3, length)
    )


def _area_map(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    areas = 1e-4 * np.array([20.0, 40.0, 60.0, 80.0])
    square, linear, constant = np.polyfit(areas, [damping(area, 50e-3, 1.75e-3) for area in areas], 2)
    return {"b_a2": square, "b_a": linear, "b_0": constant}


def _six_bar(message: Mapping[str, Any]) -> Truth:
    """Return where the linkage with the springs of this setup hangs at rest, from a long simulation of it."""
    model = load_model("six-bar")
    values = {name: message["parameters"][name] for name in ("stiffness", "damping")}
    slow = values | {"damping": 20.0 * values["damping"]}
    time_s = np.linspace(0.0, 60.0, 1201)
    outputs = simulate(model, time_s, np.empty((len(time_s), 0)), parameters=slow).outputs[-1]
    rest = dict(zip((output.name for output in model.outputs), outputs, strict=True))
    return {f"rest_{joint}": float(angle) for joint, angle in rest.items() if joint.startswith("theta_")}


def _steps(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    return {
        "magnitude_gain": 0.00912, "magnitude_lag": 0.34, "magnitude_dead_time": 0.28,
        "angle_gain": -0.866, "angle_lag": 0.13, "angle_dead_time": 0.12,
    }  # fmt: skip


def _lives(message: Mapping[str, Any]) -> Truth:  # noqa: ARG001
    return {"median_polyester_120": MEDIANS["polyester", 120], "shape_polyester_120": SHAPE}


POLYESTER = ",".join(f'{{layup="polyester",specimen={n},range=120}}' for n in range(1, 6))
LONG = ",".join(
    f'{{beam="long",specimen={n},reach={reach}}}' for n in range(1, 4) for reach in (-28.648, 28.648)
)
CASES = {
    "beam-bending": Case("population of mountings", _beam, starts=1),
    "beam-buckling": Case(
        "population of specimens", _limits,
        overrides=(f"run.conditions=[{LONG}]", "gait.joints.bend.step_deg=0.05"),
        reduced="3 long beams, steps of 0.05 deg",
    ),
    "polyester-tensile": Case("population of strips", _tensile),
    "hinge-tensile": Case("population of strips", _two_layups),
    "hinge": Case(
        "truth() of the setup", _hinge, HingeBench, overrides=("trial.repeats=1",), reduced="5 releases"
    ),
    "hinge-repeatability": Case("population of tests", _hinge_tests),
    "hinge-width": Case("(3.11), (3.12) of the bench", _width_map),
    "hinge-length": Case("(3.11), (3.12) of the bench", _length_map),
    "hinge-area": Case("(3.11) of the bench", _area_map),
    "hinge-life": Case(
        "population of hinges", _lives, overrides=(f"run.conditions=[{POLYESTER}]",), reduced="5 polyester hinges"
    ),
    "six-bar": Case(
        "rest with truth() of the setup", _six_bar, SixBar, overrides=("trial.repeats=1",), reduced="3 releases"
    ),
    "fin-step": Case("(5.5), (5.6) of the bench", _steps),
    "fin-amplitude": Case("the fit without noise", twin=("rig.scene.noise=0",)),
    "fin-modulation": Case("the fit without noise", twin=("rig.scene.noise=0",)),
    "tail-sweep": Case(
        "the fit without noise", twin=("rig.scene.noise=0",),
        overrides=(
            "sweep.axes.alpha=[60]", "sweep.axes.beta=[0]", "sweep.axes.f=[1.4]",
            "leaders.count=1", "leaders.repeats=6",
        ),
        reduced="the gait that is towed at four speeds",
    ),
}  # fmt: skip


@contextmanager
def recorded(scene: type[Bench] | None) -> Iterator[list[Bench]]:
    """Collect the instances of a scene that a run makes."""
    made: list[Bench] = []
    if scene is None:
        yield made
        return
    begin = scene.__init__

    def remember(self: Any, *arguments: Any, **keys: Any) -> None:
        begin(self, *arguments, **keys)
        made.append(self)

    scene.__init__ = remember  # type: ignore[method-assign]
    try:
        yield made
    finally:
        scene.__init__ = begin  # type: ignore[method-assign]


def once(
    name: str, case: Case, seed: int, folder: Path, more: Sequence[str] = ()
) -> tuple[Any, Mapping[str, Any]]:
    """Run and fit one seed; return the fit and what the scene tells of itself."""
    overrides = [*case.overrides, *more]
    with recorded(case.scene) as scenes:
        run = labrun.run(name, dry_run=True, seed=seed, overrides=overrides, results=folder).run
        truth = scenes[-1].truth() if scenes else {}
    return labrun.fit(run, results=folder, starts=case.starts), truth


def measured(name: str, case: Case, seed: int, folder: Path, twin: Truth) -> list[dict[str, Any]]:
    """Return a row for each parameter of one seed: truth, estimate and interval."""
    fit, message = once(name, case, seed, folder)
    truth = twin or case.truth(message)
    return [
        {
            "experiment": name, "seed": seed, "parameter": parameter, "truth": float(truth[parameter]),
            "value": float(other.value), "low": float(other.ci95[0]), "high": float(other.ci95[1]), "unit": other.unit,
        }
        for parameter, other in fit.parameters.items()
        if parameter in truth
    ]  # fmt: skip


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the Markdown table: a row for each parameter of each experiment."""
    lines = [
        "| experiment | truth is | plan | parameter | truth | mean estimate | off by | half interval | held |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    held = total = 0
    for name, case in CASES.items():
        own = [row for row in rows if row["experiment"] == name]
        for number, parameter in enumerate(dict.fromkeys(row["parameter"] for row in own)):
            seeds = [row for row in own if row["parameter"] == parameter]
            truth, value, low, high = (
                np.array([row[key] for row in seeds]) for key in ("truth", "value", "low", "high")
            )
            inside = int(np.count_nonzero((low <= truth) & (truth <= high)))
            held, total = held + inside, total + len(seeds)
            size = float(np.mean(np.abs(truth)))
            off = (
                f"{100 * float(np.mean(value - truth)) / size:+.2f} %"
                if size > 0
                else f"{np.mean(value):.2g}"
            )
            half = f"{np.mean(high - low) / 2:.2g}"
            of = (name, case.note, case.reduced or "whole") if number == 0 else ("", "", "")
            shown = f"{np.mean(truth):.4g} {seeds[0]['unit']}".removesuffix(" 1")
            cells = (
                *of,
                f"`{parameter}`",
                shown,
                f"{np.mean(value):.4g}",
                off,
                half,
                f"{inside} of {len(seeds)}",
            )
            lines.append("| " + " | ".join(cells) + " |")
    lines += ["", f"In all {held} of {total}: {100 * held / max(total, 1):.1f} %."]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=CASES, action="append", help="this experiment; repeatable")
    parser.add_argument("--store", type=Path, help="a JSON lines file that keeps every seed's result")
    parser.add_argument("--table", type=Path, help="write the table between the markers of this page")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if given.store and given.store.exists():
        rows = [json.loads(line) for line in given.store.read_text().splitlines()]
    done = {(row["experiment"], row["seed"]) for row in rows}
    for name in given.only or CASES:
        case, twin = CASES[name], dict[str, float]()
        for seed in range(1, given.seeds + 1):
            if (name, seed) in done:
                continue
            with tempfile.TemporaryDirectory() as folder:
                if case.twin and not twin:
                    fit, _ = once(name, case, 0, Path(folder), case.twin)
                    twin = {key: parameter.value for key, parameter in fit.parameters.items()}
                begin = time.monotonic()
                result = measured(name, case, seed, Path(folder), twin)
            rows += result
            print(f"{name}, seed {seed}: {time.monotonic() - begin:.0f} s", flush=True)
            if given.store:
                with given.store.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in result)
    text = table(rows)
    print(text)
    if given.table:
        page = given.table.read_text(encoding="utf-8")
        begin_mark, end_mark = "<!-- coverage -->\n", "<!-- /coverage -->"
        before, rest = page.split(begin_mark)
        after = rest.split(end_mark)[1]
        given.table.write_text(f"{before}{begin_mark}{text}\n{end_mark}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
