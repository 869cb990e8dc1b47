"""Make one case: a bench, what is hidden in it, how large, its recording, fresh trials, and the answer."""

import copy
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .bench import Bench
from .forms import FORMS, OUTSIDE, OUTSIDE_SIGNALS
from .mixture import (
    ChannelNoise,
    Chosen,
    Colour,
    aim_of,
    choose,
    draw_noise,
    kind_of,
    rescaled,
    stream_of,
    strength_class,
)
from .plant import FloatArray, Hidden, Mechanism, Plant, Programme
from .simulate import BlewUpError, adaptive, fixed
from .sizing import (
    OutOfReachError,
    Projection,
    Recalibration,
    alike,
    find_size,
    measure,
    sensor_factor,
    size_of,
)
from .writing import write_model, write_recording

FRESH_CONDITIONS = 3
FRESH_REPEATS = 3
_ATTEMPTS = 60
_LARGEST_GAP_SHARE = 0.2
"""A gap stays below this share of the signal: beyond it nobody would need a diagnosis."""
_LARGEST_NOISE_SHARE = 0.08
_MOST_SCATTER = 0.02
_ZEROS_SHARE = 1 / 7
_MOST_ALIKE = 0.9
"""Cosine of the signatures of two effects beyond which nobody could tell that there are two."""


@dataclass
class Case:
    """A case before it is written."""

    plant: Plant
    stated: dict[str, float]
    recorded: Programme
    fresh: Programme
    repeats: int
    hidden: list[Hidden]
    noise: list[ChannelNoise]
    scatter: float
    answer: dict[str, Any]


def case_name(index: int) -> str:
    """Return the name of a case's folder, numbered from one."""
    return f"case-{index + 1:04d}"


@dataclass(frozen=True)
class Asked:
    """What all cases are to have; drawn where it is None.

    Attributes
    ----------
    only
        Kind of all cases.
    zeros
        Whether every trial has a zero of its own.
    """

    only: str | None = None
    repeats: int | None = None
    noise: Colour | None = None
    zeros: bool | None = None
    conditions: int | None = None


def make_case(seed: int, index: int, folder: Path, asked: Asked | None = None) -> str:
    """Make a case, write it below `folder`, and return its name; the same for the same seed and index anywhere.

    Its kind comes from the mixture, unless one is asked for.
    """
    asked = asked or Asked()
    only = asked.only
    rng = np.random.default_rng([seed, 10111, index, *stream_of(only)])
    kind = only or kind_of(seed, index)
    zero = _zero(np.random.default_rng([seed, 40411, index]), asked.zeros)
    rejected: list[list[str]] = []
    for _ in range(_ATTEMPTS):
        chosen = choose(kind, rng)
        try:
            case = _draw(kind, chosen, rng, asked, zero)
            name = case_name(index)
            case.answer.update({"case": name, "seed": seed, "rejected_before": rejected})
            _write(case, name, folder, rng)
        except (OutOfReachError, BlewUpError):
            rejected.append(
                [f"{effect} at {site} of {chosen.plant.name}" for _, effect, site in chosen.hidden]
            )
            continue
        return name
    raise RuntimeError(f"case {index} of seed {seed}: no draw of {_ATTEMPTS} could be made")


def _zero(rng: np.random.Generator, wanted: bool | None) -> float:
    """Return how far zeros of trials scatter, in units of the sensor's noise; of one case in seven, if not asked."""
    size = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0))))
    there = rng.random() < _ZEROS_SHARE
    return size if (there if wanted is None else wanted) else 0.0


def _draw(kind: str, chosen: Chosen, rng: np.random.Generator, asked: Asked, zero: float) -> Case:
    plant = chosen.plant
    conditions = int(rng.integers(4, 11))
    conditions = asked.conditions or conditions
    both = plant.programme(rng, conditions + FRESH_CONDITIONS)
    order = rng.permutation(conditions + FRESH_CONDITIONS)
    recorded, fresh = both.take(sorted(order[:conditions])), both.take(sorted(order[conditions:]))
    repeats = int(rng.choice([1, 3, 5], p=[0.2, 0.5, 0.3]))
    repeats = asked.repeats or repeats
    aim = aim_of(kind, rng)
    stated, wrong = _stated(plant, kind, rng)

    bare = Bench(plant, recorded, plant.truth)
    outputs = fixed(bare)
    size = np.std(outputs, axis=(1, 2)) + 1e-3 * np.max(np.abs(outputs), axis=(1, 2))
    share = float(np.exp(rng.uniform(np.log(7e-4), np.log(0.03))))
    if kind in ("effect", "pair", "outside"):
        share = min(share, _LARGEST_GAP_SHARE / aim)
    noise = [replace(channel, zero=round(zero, 3)) for channel in draw_noise(rng, share * size, asked.noise)]
    sensor = np.array([channel.sd for channel in noise])
    zeros = zero > 0.0
    projection = Projection(plant, recorded, plant.truth, sensor, zeros=zeros)
    free = sum(parameter.tolerance != 0.0 for parameter in plant.parameters)
    scatter = float(np.exp(rng.uniform(np.log(0.002), np.log(0.02)))) if rng.random() < 0.5 else 0.0
    if scatter:
        moved = projection.scatter(np.full(free, scatter))
        scatter = min(scatter, scatter * 1.5 / max(float(np.max(moved / sensor)), 1e-9))
    total = np.sqrt(sensor**2 + projection.scatter(np.full(free, scatter)) ** 2)

    mechanisms = _mechanisms(chosen, bare, outputs, rng)
    alone = aim / np.sqrt(len(mechanisms)) if mechanisms else 0.0
    hidden = []
    for mechanism in mechanisms:
        target = alone * (float(rng.uniform(0.75, 1.3)) if len(mechanisms) > 1 else 1.0)
        ratio = float(np.mean(total / sensor))
        hidden.append(_sized(mechanism, plant, recorded, projection, target * ratio))

    signatures = [
        projection.signature(fixed(Bench(plant, recorded, plant.truth, [effect]))) for effect in hidden
    ]
    if len(hidden) == 2 and abs(alike(*signatures)) > _MOST_ALIKE:
        raise OutOfReachError

    # how large the gap really is, and the noise that makes it the one that is aimed at
    changed = fixed(Bench(plant, recorded, plant.truth, hidden)) if hidden else outputs
    left = Recalibration(_held(plant, wrong), recorded, stated, zeros=zeros).run(changed, total)
    if hidden or wrong:
        scatter = min(scatter * max(size_of(left.residual, total) / aim, 0.05), _MOST_SCATTER)
        scattered = projection.scatter(np.full(free, scatter))
        factor = sensor_factor(left.residual, sensor, scattered, aim)
        if float(np.max(factor * sensor / size)) > _LARGEST_NOISE_SHARE:
            raise OutOfReachError
        noise = rescaled(noise, factor)
        total = np.sqrt((factor * sensor) ** 2 + scattered**2)
    scatter = float(f"{scatter:.4g}")
    gap = size_of(left.residual, total)
    weighed = np.sqrt(np.mean((sensor / total) ** 2))
    answer = {
        "kind": kind,
        "causes": _causes(chosen, hidden, wrong),
        "hidden": [_described(effect) for effect in hidden],
        "bench": plant.name,
        "gap": {
            "aimed": aim if hidden or wrong else 0.0,
            "recalibrated": gap,
            "raw": size_of(left.raw, total),
            "alone": [float(np.sqrt(np.mean(signature**2)) * weighed) for signature in signatures],
        },
        "strength": strength_class(gap) if hidden or wrong else "none",
        "repeats": repeats,
        "conditions": conditions,
        "noise": {
            "colour": noise[0].colour,
            "sensor_sd": {output.name: n.sd for output, n in zip(plant.outputs, noise, strict=True)},
            "trial_sd": {output.name: float(s) for output, s in zip(plant.outputs, total, strict=True)},
            "correlation": noise[0].correlation,
            "zero_creep_share": noise[0].creep_share,
            "zero_by_trial": noise[0].zero,
            "parameter_scatter": scatter,
        },
        "true_parameters": plant.truth,
        "stated_parameters": stated,
        "recalibrated_parameters": left.parameters,
    }
    return Case(plant, stated, recorded, fresh, repeats, hidden, noise, scatter, answer)


def _stated(plant: Plant, kind: str, rng: np.random.Generator) -> tuple[dict[str, float], str]:
    """Return the parameters as stated, and the name of the one that is far off, if any."""
    stated = {}
    for parameter in plant.parameters:
        if parameter.tolerance == "free":
            value = parameter.true * 1.5 ** rng.uniform(-1, 1)
        else:
            value = parameter.true * (
                1.0 + parameter.tolerance * float(np.clip(rng.standard_normal(), -2, 2))
            )
        stated[parameter.name] = value if parameter.tolerance == 0.0 else float(f"{value:.4g}")
    if kind != "parameter":
        return stated, ""
    known = [parameter for parameter in plant.parameters if parameter.tolerance not in ("free", 0.0)]
    if not known:
        raise OutOfReachError
    wrong = known[rng.integers(len(known))]
    off = min(rng.uniform(5.0, 12.0) * float(wrong.tolerance), 0.5) * rng.choice([-1, 1])
    stated[wrong.name] = float(f"{wrong.true / (1.0 + off):.4g}")
    return stated, wrong.name


def _held(plant: Plant, wrong: str) -> Plant:
    """Return the plant with one parameter held where it is stated: what would be left if it were not looked at."""
    if not wrong:
        return plant
    held = copy.copy(plant)
    held.parameters = tuple(
        replace(parameter, tolerance=0.0) if parameter.name == wrong else parameter
        for parameter in plant.parameters
    )
    return held


def _mechanisms(
    chosen: Chosen, bare: Bench, outputs: FloatArray, rng: np.random.Generator
) -> list[Mechanism]:
    made = []
    for kind, effect, site in chosen.hidden:
        measures = measure(bare, outputs, kind, site)
        if not chosen.outside:
            made.append(FORMS[kind, effect](site, measures, rng))
        else:
            maker = (OUTSIDE | OUTSIDE_SIGNALS)[effect]
            made.append(maker(site, kind, measures, rng))
    return made


def _sized(
    mechanism: Mechanism, plant: Plant, recorded: Programme, projection: Projection, aim: float
) -> Hidden:
    def gap(size: float) -> float:
        return projection.left(fixed(Bench(plant, recorded, plant.truth, [Hidden(mechanism, size)])))

    return Hidden(mechanism, find_size(gap, aim, mechanism.start, mechanism.most))


def _causes(chosen: Chosen, hidden: list[Hidden], wrong: str) -> list[dict[str, Any]]:
    if wrong:
        return [{"kind": "parameter", "effect": wrong, "site": ""}]
    if chosen.outside:
        return []
    return [
        {
            "kind": "effect",
            "effect": effect.mechanism.effect,
            "site": effect.mechanism.site,
            "site_kind": effect.mechanism.kind,
        }
        for effect in hidden
    ]


def _described(hidden: Hidden) -> dict[str, Any]:
    return {
        "effect": hidden.mechanism.effect,
        "site": hidden.mechanism.site,
        "site_kind": hidden.mechanism.kind,
        "form": hidden.mechanism.form,
        "size": hidden.size,
        "values": {key: float(value) for key, value in hidden.mechanism.values(hidden.size).items()},
    }


def _write(case: Case, name: str, folder: Path, rng: np.random.Generator) -> None:
    plant, recorded = case.plant, len(case.recorded.conditions)
    first, second = recorded * case.repeats, len(case.fresh.conditions) * FRESH_REPEATS
    which = [index for index in range(recorded) for _ in range(case.repeats)]
    both = Programme(
        case.recorded.time_s,
        [*case.recorded.conditions, *case.fresh.conditions],
        np.concatenate([case.recorded.inputs, case.fresh.inputs], axis=2),
    )
    which += [recorded + index for index in range(len(case.fresh.conditions)) for _ in range(FRESH_REPEATS)]
    truth = _truth(case, both, which, rng)
    measured = np.stack(
        [
            np.stack([case.noise[row].apply(truth[row, :, trial], rng) for row in range(len(plant.outputs))])
            for trial in range(first + second)
        ]
    )
    trials = [
        (both.conditions[which[trial]], repeat, both.inputs[:, :, which[trial]], measured[trial])
        for trial, repeat in enumerate(_repeats(which))
    ]
    for part, chosen in (("cases", trials[:first]), ("fresh", trials[first:])):
        write_recording(plant, plant.name, folder / part / name, both.time_s, chosen)
        write_model(plant, case.stated, folder / part / name / "model.toml")
    sealed = folder / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    (sealed / f"{name}.json").write_text(json.dumps(case.answer, indent=1) + "\n", encoding="utf-8")


def _repeats(which: list[int]) -> list[int]:
    return [which[:index].count(kind) + 1 for index, kind in enumerate(which)]


def _truth(case: Case, both: Programme, which: list[int], rng: np.random.Generator) -> FloatArray:
    """Return the noise-free outputs of every trial; without scatter equal trials are simulated once."""
    plant = case.plant
    if not case.scatter:
        outputs = adaptive(Bench(plant, both, plant.truth, case.hidden))
        return outputs[:, :, which]
    programme = both.take(which)
    values = {
        parameter.name: np.full(len(which), parameter.true)
        if parameter.tolerance == 0.0
        else parameter.true * (1.0 + case.scatter * rng.standard_normal(len(which)))
        for parameter in plant.parameters
    }
    start = plant.start(programme.conditions)
    start = start * (1.0 + 0.5 * case.scatter * rng.standard_normal(start.shape))
    return adaptive(Bench(plant, programme, values, case.hidden, start))
