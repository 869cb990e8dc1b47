"""How often intervals of the specimen rigs hold the truth of their benches, and what a hinge of 50,000 cycles costs.

    python benchmarks/specimens.py                  # five seeds of each rig, run and fitted as a person would, and
                                                    # their figures beside the published ones
    python benchmarks/specimens.py --draws 400      # as many batches, without the runner: benches and fits alone
    python benchmarks/specimens.py --life           # one trial of 50,000 cycles, killed on its way and resumed
    python benchmarks/specimens.py --hidden         # causes that are drawn and sealed, and their diagnoses

Each seed of the first is ``labrun run NAME --dry-run --seed S`` and ``labrun fit NAME``, in a folder that is thrown
away: hinges of polyester only, beams bent in steps of 0.05 deg. Truth is what the benches are set to, the means of
their populations. With --draws, benches are observed directly, without noise of the sensors, and read by the functions
that the fits use. With --hidden, ``--hide random`` draws an effect, a site and a size for each seed, or nothing.
"""

import argparse
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from labrun_plugins.rigs.beam.limits import buckling_limit
from labrun_plugins.rigs.beam.scene import LIMITS_N_M, BeamBench
from labrun_plugins.rigs.hinge_life.lives import fit_weibull, intervals
from labrun_plugins.rigs.hinge_life.scene import LifeBench
from labrun_plugins.rigs.tensile.fit import TensileCurve, tensile_curve
from labrun_plugins.rigs.tensile.scene import GRIPS_M, THICKNESS_M, WIDTH_M, YIELD_PA, YOUNG_PA, TensileBench

import labrun
from labrun.app.diagnose import reveal
from labrun.devices import Trajectory
from labrun.fit import student

POLYESTER = ",".join(f'{{layup="polyester",specimen={n},range=120}}' for n in range(1, 6))
BEAMS = ",".join(
    f'{{beam="{beam}",specimen={n},reach={reach}}}'
    for beam in ("long", "short", "polyester", "steel")
    for n in range(1, 4)
    for reach in (-28.648, 28.648)
)
HIDDEN = {
    "polyester-tensile": [],
    "hinge-tensile": [],
    "hinge-life": ["trial.until.max_cycles=300"],
    "hinge-repeatability": [],
    "fin-materials": [],
    "fin-trace": [],
    "fin-amplitude": [],
    "beam-buckling": [],
}
"""Rigs on which causes are hidden, and what of their files is changed for it."""
CHAINS = {
    "polyester-tensile": [],
    "hinge-life": [f"run.conditions=[{POLYESTER}]"],
    "beam-buckling": [f"run.conditions=[{BEAMS}]", "gait.joints.bend.step_deg=0.05"],
    "hinge-repeatability": [],
    "fin-materials": [],
}
TRUTH = {
    "young": 1e-6 * YOUNG_PA,
    "yield_stress": 1e-6 * YIELD_PA,
    "toe_strain": 0.25,
    "median_polyester_120": 2500.0,
    "shape_polyester_120": 3.0,
    **{
        f"{sense} {beam}": LIMITS_N_M[beam][index]
        for beam in ("long", "short")
        for index, sense in enumerate(("equal", "opposite"))
    },
}
Interval = tuple[float, float, float]
"""Estimate, and the ends of its 95 % interval."""


def chained(
    seed: int, folder: Path, without_interval: dict[str, list[float]]
) -> Iterator[tuple[str, Interval]]:
    """Run and fit every rig once; what has no interval goes into `without_interval`."""
    for name, overrides in CHAINS.items():
        run = labrun.run(name, dry_run=True, seed=seed, overrides=overrides, results=folder).run
        if name == "fin-materials":
            off = labrun.compare(run, "table-5-2", results=folder).comparison.worst.relative
            without_interval.setdefault("table 5.2, worst", []).append(off)
            continue
        if name == "hinge-repeatability":
            rows = {row[0]: row[1:] for row in labrun.fit(run).tables[0].rows}
            for index, what in enumerate(("stiffness", "damping")):
                without_interval.setdefault(f"{what}, mean", []).append(float(rows["mean"][index]))
                without_interval.setdefault(f"{what}, sd", []).append(
                    float(rows["standard deviation"][index])
                )
            continue
        if name == "beam-buckling":
            loops = labrun.open(run).trials.groupby("beam")["loop"].mean()
            without_interval.setdefault("loop, steel over polyester", []).append(
                loops["steel"] / loops["polyester"]
            )
            findings = labrun.fit(run, settings={"beam": "long"}).findings
            holds = [finding for finding in findings if finding.startswith("the arc") and "holds" in finding]
            without_interval.setdefault("arc holds", []).append(float(len(holds)))
        for beam in ("long", "short") if name == "beam-buckling" else ("",):
            parameters = labrun.fit(run, settings={"beam": beam} if beam else None).parameters
            for key, parameter in parameters.items():
                message = f"{key.removesuffix('_limit')} {beam}" if beam else key
                if message in TRUTH:
                    yield message, (parameter.value, *parameter.ci95)


def drawn(seed: int) -> Iterator[tuple[str, Interval]]:
    """Observe one batch of specimens on every bench."""
    rng = np.random.default_rng(seed)
    curves = [strip(seed, number) for number in range(11)]
    yield "young", over([1e-6 * curve.young_pa for curve in curves])
    yield "yield_stress", over([1e-6 * curve.yield_pa for curve in curves])
    yield "toe_strain", over([100 * curve.toe_strain for curve in curves])
    lives = LifeBench({}, rng)
    lives.arrange({"layup": "polyester", "range": 120})
    cycles = []
    for number in range(5):
        lives.mount(number)
        cycles.append(math.ceil(lives.truth()["life"]))
    weibull = fit_weibull(np.array(cycles, dtype=float), np.ones(5, dtype=bool))
    median, shape = intervals(weibull, 5, 5, rng)
    yield "median_polyester_120", (weibull.median, *median)
    yield "shape_polyester_120", (weibull.shape, *shape)
    for beam in ("long", "short"):
        bench, begin_s = BeamBench({"beam": beam}, rng), 1.0
        bench.observe(("force",), np.array([0.0]))
        for sense, way_m in (("equal", -0.05), ("opposite", 0.05)):
            limits = []
            for _ in range(3):
                limits.append(bent(bench, way_m, begin_s))
                begin_s += 102.0
            yield f"{sense} {beam}", over(limits)


def strip(seed: int, number: int, bench: TensileBench | None = None) -> TensileCurve:
    bench = TensileBench({}, np.random.default_rng(seed)) if bench is None else bench
    bench.observe(("force",), np.array([0.0]))
    bench.arrange({"specimen": number})
    bench.tow(0.0, 0.002, 1.6667e-4, 0.5)
    force, position = bench.observe(("force", "position"), np.arange(0.5, 12.4, 1 / 80)).T
    return tensile_curve(force, position, area_m2=THICKNESS_M * WIDTH_M, grips_m=GRIPS_M)


def bent(bench: BeamBench, way_m: float, begin: float) -> float:
    """Bend a new beam there and back in 100 s; return its limit, N m."""
    bench.mount(1)
    points = np.array([[0.0], [way_m], [0.0]])
    bench.drive("pusher", Trajectory(("pusher",), np.array([0.0, 50.0, 100.0]), points), begin)
    parts = np.array_split(begin + np.arange(0.0, 100.0, 0.1), 10)
    force, position = np.vstack([bench.observe(("force", "position"), part) for part in parts]).T
    return buckling_limit(force, position, 0.1).torque_n_m


def over(values: Sequence[float]) -> Interval:
    """Return mean and t-interval over specimens."""
    mean, count = float(np.mean(values)), len(values)
    half = student(count - 1) * float(np.std(values, ddof=1)) / math.sqrt(count)
    return mean, mean - half, mean + half


def print_coverage(results: dict[str, list[Interval]]) -> None:
    """Print how often intervals hold the truth, and how far means of the estimates lie from it."""
    print("| quantity | truth | mean of the estimates | off by | half interval, mean | truth held |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, rows in results.items():
        estimates, lows, highs = np.array(rows).T
        truth = TRUTH[name]
        held = int(np.count_nonzero((lows <= truth) & (truth <= highs)))
        half = float(np.mean(highs - lows)) / 2
        print(
            f"| {name} | {truth:g} | {estimates.mean():.4g} | {100 * (estimates.mean() / truth - 1):+.2f} % "
            f"| {half:.3g} | {held} of {len(rows)} |"
        )


def print_comparison(
    results: dict[str, list[Interval]], without_interval: dict[str, list[float]], seeds: int
) -> None:
    """Print what is measured beside what the source has, and how far off that may be."""
    own = np.array([strip_off(seed, number) for seed in range(seeds) for number in range(11)]).T
    lives = results["median_polyester_120"]
    holds = sum(low <= 2500.0 <= high for _, low, high in lives)
    rows = [
        (f"{what}, mean of a seed", unit, TRUTH[key], [interval[0] for interval in results[key]], share)
        for what, key, unit, share in (
            ("modulus", "young", "MPa", 0.015),
            ("yield stress", "yield_stress", "MPa", 0.02),
            *((f"{beam}, {sense} limit", f"{sense} {beam}", "N m", 0.03) for beam in ("long", "short")
              for sense in ("equal", "opposite")),
        )
    ]  # fmt: skip
    print("| figure | published | all seeds | off by | worst seed | accepted |")
    print("| --- | --- | --- | --- | --- | --- |")
    for what, unit, truth, values, share in rows:
        off = np.array(values) / truth - 1.0
        print(
            f"| {what} | {truth:g} {unit} | {np.mean(values):.5g} | {100 * off.mean():+.2f} % "
            f"| {100 * off[np.argmax(abs(off))]:+.2f} % | {100 * share:g} % |"
        )
    for what, unit, off in zip(
        ("modulus of a strip", "yield stress of a strip", "toe of a strip"),
        ("%", "%", "% strain"),
        own,
        strict=True,
    ):  # without the scatter between specimens, which moves the mean of eleven by 0.6 and 0.9 % (one sigma)
        print(
            f"| {what} | its own | | {np.mean(off):+.3f} {unit} | {max(off, key=abs):+.3f} {unit} "
            f"| {'0.02 % strain' if what.startswith('toe') else ''} |"
        )
    print(
        f"| life at +-120 deg | 2500 | {np.mean([interval[0] for interval in lives]):.0f} | | | inside "
        f"{holds} of {len(lives)} |"
    )
    for what, truth, sd in (("stiffness", 0.068633, 0.0226), ("damping", 2.8863e-4, 0.0318)):
        means = np.array(without_interval[f"{what}, mean"])
        share = math.sqrt(np.mean((np.array(without_interval[f"{what}, sd"]) / means) ** 2))
        print(
            f"| Table 3.2, {what} | {truth:.4g}, {100 * sd:.1f} % | {means.mean():.4g}, {100 * share:.1f} % "
            f"| {100 * (means.mean() / truth - 1):+.1f} % | | |"
        )
    print(
        f"| Table 5.2, thrust | 7 fins | | | {100 * max(without_interval['table 5.2, worst']):.1f} % | 5 % |"
    )
    loops = without_interval["loop, steel over polyester"]
    print(
        f"| loop area, steel over polyester | larger | {np.mean(loops):.2f} | | {min(loops):.2f} | above 1 |"
    )
    held = int(sum(without_interval["arc holds"]))
    print(f"| tape spring: width that holds | arc | arc in {held} of {seeds} | | | |")


def strip_off(seed: int, number: int) -> tuple[float, float, float]:
    """Return how far modulus, yield stress (%) and toe (% of strain) of a strip are told from what its bench has."""
    bench = TensileBench({}, np.random.default_rng(seed))
    curve = strip(seed, number, bench)
    truth = bench.truth()
    young, yields = (float(truth["parameters"][name]) for name in ("young", "yield_stress"))
    return (
        100.0 * (curve.young_pa / young - 1.0),
        100.0 * (curve.yield_pa / yields - 1.0),
        100.0 * (curve.toe_strain - float(truth["slack"])),
    )


def life(folder: Path) -> None:
    """Run a sandwich for 50,000 cycles, kill the run on its way, resume it, and tell sizes."""
    sandwich = 'run.conditions=[{layup="sandwich",specimen=1,range=120}]'
    command = [sys.executable, "-m", "labrun"]
    begin = time.monotonic()
    run = [*command, "run", "hinge-life", "--dry-run", "--seed", "1", "--set", sandwich]
    process = subprocess.Popen([*run, "--set", "rig.scene.shape=30"], cwd=folder, stdout=subprocess.DEVNULL)
    log = None
    while process.poll() is None and (log is None or log.stat().st_size < 4_000_000):
        time.sleep(0.5)
        log = next(iter(folder.glob("results/hinge-life/*/cycles/*.jsonl")), None)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert log is not None
    whole = [json.loads(line) for line in log.read_text().splitlines() if line.endswith("}")]
    cycles = sum(loads["event"] == "cycle" for loads in whole)
    parent = log.parents[1]
    size = sum(path.stat().st_size for path in parent.rglob("*") if path.is_file())
    print(f"killed with {cycles} cycles on disk, {1e-6 * size:.0f} MB")
    before = log.read_bytes()
    before = before[: before.rfind(b"\n") + 1]
    subprocess.run([*command, "resume", str(parent)], cwd=folder, check=True)
    kept = log.read_bytes().startswith(before) if log.exists() else None
    print(f"what was on disk is {'as it was' if kept else 'packed' if kept is None else 'CHANGED'}")
    subprocess.run([*command, "fit", str(parent)], cwd=folder, check=True)
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(f"greatest memory of a process: {most / 1000:.0f} MB")
    print(
        f"whole trial: {1e-6 * sum(path.stat().st_size for path in parent.rglob('*') if path.is_file()):.1f} MB"
    )
    print(f"{time.monotonic() - begin:.0f} s")


def hidden(seeds: Sequence[int], names: Sequence[str], folder: Path) -> None:
    """Hide what is drawn on every rig, diagnose it, open the seals, and print what was said beside what was hidden."""
    print("| experiment | seed | hidden | said | score | processor time, s |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in names:
        for seed in seeds:
            run = labrun.run(
                name,
                dry_run=True,
                seed=seed,
                hide_seed=seed,
                hide=["random"],
                overrides=HIDDEN[name],
                results=folder,
            ).run
            begin = time.process_time()
            diagnosis = labrun.diagnose(run, workers=1, page=False, results=folder).diagnosis
            spent_s = time.process_time() - begin
            compared = reveal(run, results=folder)
            causes = [
                " or ".join(map(str, (cause.name, *cause.indistinguishable_from)))
                for cause in diagnosis.causes
            ]
            was = (
                "; ".join(f"{effect.effect} at {effect.site}" for effect in compared.revealed.hidden)
                or "nothing"
            )
            message = "; ".join(causes) or diagnosis.verdict
            print(f"| {name} | {seed} | {was} | {message} | {compared.score} | {spent_s:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--draws", type=int, help="batches without the runner, instead")
    parser.add_argument("--life", action="store_true", help="one trial of 50,000 cycles, instead")
    parser.add_argument("--hidden", action="store_true", help="hidden causes, drawn by seed, instead")
    parser.add_argument("--only", choices=HIDDEN, action="append", help="with --hidden: this rig; repeatable")
    given = parser.parse_args()
    results: dict[str, list[Interval]] = {}
    without_interval: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        if given.life:
            subprocess.run(
                [sys.executable, "-m", "labrun", "init"], cwd=folder, check=True, stdout=subprocess.DEVNULL
            )
            life(Path(folder))
            return
        if given.hidden:
            hidden(range(given.seeds), given.only or list(HIDDEN), Path(folder))
            return
        for seed in range(given.draws or given.seeds):
            for name, interval in (
                drawn(seed) if given.draws else chained(seed, Path(folder), without_interval)
            ):
                results.setdefault(name, []).append(interval)
    print_coverage(results)
    if without_interval:
        print_comparison(results, without_interval, given.seeds)


if __name__ == "__main__":
    main()
