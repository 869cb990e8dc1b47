"""Specimens of one or several runs, each with stiffness and damping of every release."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labrun.devices import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit import Dataset, Estimate, FitJob, FitTrial, is_recording, load_dataset
from labrun.models import Model
from labrun.toml import nearest
from labrun_plugins.rigs.hinge.body import FOUND, SpecimenBody, body_of, with_body
from labrun_plugins.rigs.hinge.free_swings import fit_hinge

SIZES = {"a": ("area_cm2", 1e-4), "l": ("length_mm", 1e-3), "w": ("width_mm", 1e-3)}
"""Which name of a condition is which variable of the maps, and what makes it m or m^2."""


@dataclass(frozen=True, slots=True)
class Specimen:
    """One hinge with one body, in one run.

    Attributes
    ----------
    label
        Names it in messages.
    sizes
        a (m^2), l (m), w (m).
    values, fourier : (n, 2)
        Stiffness and damping of every release, by simulation and by Fourier derivatives.
    estimates, fourier_estimates
        Means over releases with 95 % intervals from resampling whole releases, by quantity.
    warnings
        What the fit of this specimen alone had to say.
    """

    label: str
    run: str
    sizes: Mapping[str, float]
    body: SpecimenBody
    values: FloatArray
    fourier: FloatArray
    estimates: Mapping[str, Estimate]
    fourier_estimates: Mapping[str, Estimate]
    warnings: tuple[str, ...]

    def by(self, way: str) -> tuple[FloatArray, Mapping[str, Estimate]]:
        """Return releases and estimates of one way, "simulation" or "fourier"."""
        return (
            (self.values, self.estimates) if way == "simulation" else (self.fourier, self.fourier_estimates)
        )


@dataclass(frozen=True, slots=True)
class Specimens:
    """All specimens of a fit, those that could not be fitted left out.

    Attributes
    ----------
    every
        By width, length, area and run.
    first, more
        The first run or recording, and the names of the others.
    left_out
        Releases that do not count.
    refused
        Why specimens were left out.
    """

    every: tuple[Specimen, ...]
    first: Dataset
    more: tuple[str, ...]
    left_out: int
    refused: tuple[str, ...]

    @property
    def trials(self) -> int:
        """How many releases there are."""
        return sum(len(specimen.values) for specimen in self.every)


def load_specimens(job: FitJob, stated: Mapping[str, float]) -> Specimens:
    """Fit every specimen of the job's runs by itself.

    Parameters
    ----------
    stated
        Sizes that conditions do not name, by the names of conditions (`SIZES`).

    Raises
    ------
    RequestError
        No model; a size that neither condition nor settings name; the same run twice.
    FitError
        A model that is not a hinge; nothing can be fitted.
    """
    if job.model is None:
        raise RequestError(
            f"hinge-maps needs a model of the bodies that hung on the hinges, and {job.target} names none",
            hint="give one by --model FILE or [fit] model; models/hinge-specimens.toml is a plate's",
        )
    targets = [job.target, *job.more]
    _require_different(targets)
    datasets = [_dataset(target, job.model, job.signals) for target in targets]
    runs = _named_apart([dataset.name for dataset in datasets])
    groups = [
        (run, dataset, trials, sizes)
        for run, dataset in zip(runs, datasets, strict=True)
        for sizes, trials in _grouped(dataset, stated)
    ]
    specimens: list[Specimen] = []
    refused: list[tuple[str, FitError]] = []
    lost = sum(dataset.left_out for dataset in datasets)
    for number, (run, dataset, trials, sizes) in enumerate(groups, start=1):
        label = _label(sizes, [other for *_, other in groups], run)
        job.note(f"specimen {number} of {len(groups)}: {label}")
        try:
            specimen = _fitted(
                job, job.model, replace(dataset, trials=trials, left_out=0), sizes, stated, label, run
            )
        except FitError as error:
            refused.append((label, error))
            lost += len(trials)
            continue
        specimens.append(specimen)
        lost += len(trials) - len(specimen.values)
    if not specimens:
        raise refused[0][1]
    left_out = tuple(f"{label} is left out: {error.args[0]}" for label, error in refused)
    specimens.sort(
        key=lambda specimen: [
            *(specimen.sizes[letter] for letter in ("w", "l", "a")),
            runs.index(specimen.run),
        ]
    )
    return Specimens(tuple(specimens), datasets[0], tuple(runs[1:]), lost, left_out)


def _require_different(targets: Sequence[Path]) -> None:
    known: set[Path] = set()
    for target in targets:
        folder = (target.parent if target.name == "run.h5" else target).resolve()
        if folder in known:
            raise RequestError(
                f"{target} is named twice: its specimens would count double",
                hint="name every run once; a run folder (results/hinge-width/...) names one of "
                "several runs of an experiment",
            )
        known.add(folder)


def _dataset(target: Path, model: Model, signals: Mapping[str, str]) -> Dataset:
    outputs = {output.name for output in model.outputs}
    wanted = {name: channel for name, channel in signals.items() if name in outputs}
    # a recording has channels of its own, not the devices of an experiment
    plain = is_recording(target) and any("." in channel for channel in wanted.values())
    return load_dataset(target, model, {} if plain else wanted)


def _named_apart(names: Sequence[str]) -> list[str]:
    return [
        f"{name} ({names[: index + 1].count(name)})" if names.count(name) > 1 else name
        for index, name in enumerate(names)
    ]


def _grouped(
    dataset: Dataset, stated: Mapping[str, float]
) -> list[tuple[dict[str, float], tuple[FitTrial, ...]]]:
    groups: dict[tuple[float, ...], list[FitTrial]] = {}
    for trial in dataset.trials:
        groups.setdefault(_sizes(trial, stated, dataset), []).append(trial)
    return [(dict(zip(SIZES, sizes, strict=True)), tuple(trials)) for sizes, trials in groups.items()]


def _sizes(trial: FitTrial, stated: Mapping[str, float], dataset: Dataset) -> tuple[float, ...]:
    sizes = []
    for name, factor in SIZES.values():
        value = trial.condition.get(name, stated.get(name))
        if value is None:
            near = nearest(name, trial.condition)
            raise RequestError(
                f"{trial.label} of {dataset.name} does not say {name}: its condition names "
                f"{', '.join(trial.condition) or 'nothing'}",
                hint=(f"did you mean {name} by {near}? " if near else "")
                + f"name it in the conditions, or once for all trials: --set {name}=NUMBER",
            )
        if isinstance(value, str) or not value > 0 or not np.isfinite(value):
            raise RequestError(
                f"{trial.label} of {dataset.name}: {name} is {value!r}, where a size is a positive number",
                hint="correct the condition in the experiment or in recording.toml",
            )
        sizes.append(float(value) * factor)
    return tuple(sizes)


def _label(sizes: Mapping[str, float], every: Sequence[Mapping[str, float]], run: str) -> str:
    """Name a specimen by what differs between specimens, and by its run where that is not enough."""
    differing = {
        name: f"{sizes[name] / factor:g}"
        for name, (_, factor) in SIZES.items()
        if any(other[name] != sizes[name] for other in every)
    }
    if "w" in differing and "l" in differing:
        parts = [f"{differing['w']} x {differing['l']} mm"]
    else:
        words = {"w": "mm wide", "l": "mm long"}
        parts = [f"{differing[name]} {word}" for name, word in words.items() if name in differing]
    parts += [f"{differing['a']} cm^2"] if "a" in differing else []
    label = ", ".join(parts) or "the specimen"
    return f"{label} ({run})" if sum(other == sizes for other in every) > 1 else label


def _fitted(
    job: FitJob,
    model: Model,
    dataset: Dataset,
    sizes: Mapping[str, float],
    stated: Mapping[str, float],
    label: str,
    run: str,
) -> Specimen:
    body = body_of(model, {**stated, **dataset.trials[0].condition})
    result = fit_hinge(
        dataset, with_body(model, body), rng=job.rng, starts=job.starts or 2, body_in_intervals=False
    )
    ways = []
    for way in ("", "_fourier"):
        releases = [[release[f"{name}{way}"] for name in FOUND] for release in result.by_trial]
        # a single release comes back as the estimate itself
        single = [[result.parameters[f"{name}{way}"].value for name in FOUND]]
        ways.append(
            (np.array(releases or single), {name: result.parameters[f"{name}{way}"] for name in FOUND})
        )
    # how many releases there are is told once for all specimens
    notes = tuple(text for text in result.warnings if "rest on" not in text)
    (values, estimates), (fourier, fourier_estimates) = ways
    return Specimen(label, run, sizes, body, values, fourier, estimates, fourier_estimates, notes)
