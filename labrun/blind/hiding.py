"""Choose what a dry run hides, as stated or at random."""

import math
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labrun.blind.rehearsal import HidingScene, Rehearsal, concealed, hiding_scene
from labrun.blind.seal import PARAMETER, Seal, is_sealed, read_seal
from labrun.effects import Effect, EffectParameter, Scale, effects, load_effect
from labrun.errors import ModelError, PluginError, RequestError
from labrun.experiment import Experiment, LoadedExperiment, Value, find_model_file
from labrun.models import Model, Site, load_model
from labrun.search import conditions as conditions_of
from labrun.store import RunFolder, find_run
from labrun.toml import suggest

Condition = Mapping[str, Value]

NOTHING_SHARE = 1 / 6
"""How often ``--hide random`` hides nothing: a diagnosis that always finds something has to be wrong at times."""
_SMALLEST, _LARGEST = 0.8, 10.0
"""Range of a drawn size: what recalibration leaves of it, in units of the scatter between two trials."""
_FACTORS = (1e-3, 30.0)
"""Where a value of that size is looked for, in units of where a search for the effect starts."""
_CLOSE = 1.25
_HALVINGS = 14
_SHAPE_SPREAD = 1.5
_TRIES = 100

RANDOM = "random"
NONE = "none"
SAME_AS = "same-as:"


@dataclass(frozen=True, slots=True)
class HiddenBench:
    """A simulated bench with what it hides.

    Attributes
    ----------
    experiment
        As the dry run carries it out; never what is stored.
    seal
        Of what it hides.
    seed
        Of the run whose bench it is, None for a new one: what was built from the seed there is built from it here.
    """

    experiment: Experiment
    seal: Seal
    seed: int | None


def choose_hidden(
    wanted: Sequence[str],
    experiment: Experiment,
    model: Model | None,
    conditions: Sequence[Condition],
    *,
    seed: int | None = None,
) -> list[dict[str, Any]]:
    """Return what a dry run is to hide, JSON-ready; an empty list is nothing.

    Parameters
    ----------
    wanted
        ``"random"``, ``"none"``, or ``"EFFECT@SITE"``, ``"EFFECT@SITE:name=value,..."`` and ``"PARAMETER=value"``, what
        a parameter of the bench really is, as often as wanted.
    experiment
        Its scene must be able to hide effects.
    model
        Which will be compared with the run; what is drawn is at a site that it knows. Needed for ``"random"``.
    conditions
        What the run measures.
    seed
        Of the draw. Without it nobody can repeat the draw: it has nothing to do with the seed of the run.

    Raises
    ------
    RequestError
        Something wanted does not exist or does not fit, with the nearest that would.
    """
    if experiment.rig.scene is not None and experiment.rig.scene.settings.get("hide"):
        raise RequestError(
            "rig.scene.hide hides something in the open already", hint="take it out, or leave out --hide"
        )
    if len(wanted) > 1 and (NONE in wanted or RANDOM in wanted):
        raise RequestError(f"--hide {NONE if NONE in wanted else RANDOM} stands alone")
    if RANDOM in wanted and model is None:
        raise RequestError(
            "--hide random draws among what the experiment's model could lack, and it names no model",
            hint='give its file a table [gap] with model = "..."',
        )
    scene = hiding_scene(experiment)
    if NONE in wanted:
        return []
    if model is not None and RANDOM in wanted:
        rng = np.random.default_rng(secrets.randbits(128) if seed is None else seed)
        return [
            _with_units(hidden, scene, model) for hidden in _drawn(experiment, scene, model, conditions, rng)
        ]
    return [
        _with_units(_parsed(text, scene), scene, model) if "@" in text else _parameter(text, scene, model)
        for text in wanted
    ]


def _with_units(hidden: dict[str, Any], scene: HidingScene, model: Model | None) -> dict[str, Any]:
    """Return a hidden effect with the units of its values."""
    coordinates = {
        location.name: location.unit or ("m" if location.kind == "body" else "rad")
        for location in scene.places
    }
    signals = dict(scene.signals)
    if model is not None:
        coordinates |= {site.name: model.coordinate_unit(site) for site in model.sites}
        signals |= {signal.name: signal.unit for signal in model.inputs}
        signals |= {output.name: output.unit for output in model.outputs}
    units = coordinates.get(hidden["site"], "rad"), signals.get(hidden["site"], "1")
    parameters = load_effect(hidden["effect"], hidden["kind"]).parameters
    return {**hidden, "units": {parameter.name: parameter.unit(*units) for parameter in parameters}}


def hidden_bench(
    loaded: LoadedExperiment, hide: Sequence[str], *, seed: int | None, simulated: bool, results: Path
) -> HiddenBench:
    """Return the bench of a dry run with what it hides, and the seal of that.

    Parameters
    ----------
    hide
        See `choose_hidden`; or ``["same-as:RUN"]``, the bench of a run: an experiment's name (its latest run) or a run
        folder.
    seed
        See `choose_hidden`.
    simulated
        Whether the bench of the run is a simulated one.
    results
        Folder of the runs.

    Raises
    ------
    RequestError
        The bench of the run is not simulated, what is to be hidden does not exist or does not fit, or there is no such
        run.
    """
    if not simulated:
        raise RequestError(
            "--hide is for simulated benches: a real one hides enough", hint="add --dry-run, or --emulate"
        )
    experiment, run_seed = loaded.experiment, None
    if any(pattern.startswith(SAME_AS) for pattern in hide):
        if len(hide) > 1:
            raise RequestError(f"--hide {SAME_AS}RUN stands alone")
        run = find_run(hide[0].removeprefix(SAME_AS), results)
        origin = RunFolder(run).provenance
        if not is_sealed(origin):
            raise RequestError(
                f"{run} hides nothing under seal",
                hint="name a run that was started with --hide random or --hide EFFECT@SITE",
            )
        run_seed, hidden = int(origin["seed"]), read_seal(run, origin).hidden()
    else:
        model = named_model(loaded)
        hidden = choose_hidden(hide, experiment, model, conditions_of(experiment), seed=seed)
    return HiddenBench(concealed(experiment, hidden), Seal.of(hidden), run_seed)


def named_model(loaded: LoadedExperiment) -> Model | None:
    """Return the model that an experiment's ``[gap]`` names, else its ``[fit]``; None if it names none."""
    experiment = loaded.experiment
    names = [table.model for table in (experiment.gap, experiment.fit) if table is not None and table.model]
    if not names:
        return None
    return load_model(find_model_file(names[0], loaded.path, Path.cwd()) or names[0])


def _drawn(
    experiment: Experiment,
    scene: HidingScene,
    model: Model,
    conditions: Sequence[Condition],
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Draw an effect, a site and a size at which it shows, or nothing."""
    if rng.random() < NOTHING_SHARE:
        return []
    fitting = candidates(scene, model, tared=experiment.trial.tare is not None)
    if not fitting:
        raise RequestError(
            f"no effect fits a site that both model {model.name} and the scene know",
            hint=f"the scene's sites: {', '.join(dict.fromkeys(site.name for site in scene.places))}",
        )
    rehearsal = Rehearsal(experiment, model, conditions)
    # Every kind of effect is as likely as every other, at however many sites it fits.
    kinds = sorted({(effect.id, effect.kind) for effect, _ in fitting})
    for _ in range(_TRIES):
        kind = kinds[int(rng.integers(len(kinds)))]
        of_kind = [pair for pair in fitting if (pair[0].id, pair[0].kind) == kind]
        effect, site = of_kind[int(rng.integers(len(of_kind)))]
        size = math.exp(rng.uniform(math.log(_SMALLEST), math.log(_LARGEST)))
        hidden = _of_size(size, Draw(effect, scene.scale, rng), site.name, rehearsal)
        if hidden is not None:
            return [hidden]
    raise RequestError(
        f"no effect that was drawn shows in this experiment, of {len(kinds)} kinds",
        hint="name one: --hide EFFECT@SITE; or let the experiment move more",
    )


def candidates(scene: HidingScene, model: Model, *, tared: bool) -> list[tuple[Effect, Site]]:
    """Return every installed effect at every site that scene and model both have, and at which it can do something."""
    ours, theirs = list(scene.places), list(model.places)
    same_order = _outputs(ours) == _outputs(theirs)
    options = []
    for site in theirs:
        twin = next((other for other in ours if (other.name, other.kind) == (site.name, site.kind)), None)
        if twin is None:
            continue
        for effect in effects():
            if not (effect.fits(site) and effect.fits(twin, scene.scale)):
                continue
            if effect.signals > 1 and not (same_order and len(_outputs(theirs)) >= effect.signals):
                continue  # what the next signal is depends on the order of all
            if effect.needs_acceleration and site.rate not in model.states:
                continue  # the model could not say what the acceleration is
            if effect.ahead:
                continue  # a bench goes step by step: it would hide the slope of what it cannot know yet
            if effect.id == "drift" and not tared:
                continue  # it runs for as long as the run: without a tare it would be a step between trials
            options.append((effect, site))
    return options


class Draw:
    """One drawn effect whose strength is still open: the shape of its values, and where its sizes start.

    `scale`: typical magnitudes on the bench. `rng`: draws the sign and the shape.
    """

    def __init__(self, effect: Effect, scale: Scale, rng: np.random.Generator) -> None:
        self.effect = effect
        self._scale = scale
        self._start = int(rng.integers(max(len(parameter.starts) for parameter in effect.parameters)))
        spread = math.log(_SHAPE_SPREAD)
        self._shape = [math.exp(rng.uniform(-spread, spread)) for _ in effect.parameters]

    def values(self, factor: float) -> dict[str, float]:
        """Return values of a strength; 1 is where a search for the effect would start."""
        return {
            parameter.name: self._value(parameter, shape, factor)
            for parameter, shape in zip(self.effect.parameters, self._shape, strict=True)
        }

    def simpler(self, site: str, values: Mapping[str, float]) -> list[dict[str, Any]]:
        """Return the effects that this one contains, at its strength: what an experiment may show of it and no more.

        Stribeck friction at one speed is Coulomb friction. Two that contain each other are rivals to a diagnosis.
        """
        options = []
        simpler = (
            effect
            for effect in effects()
            if effect.id in self.effect.contains and effect.kind == self.effect.kind
        )
        for simple in simpler:
            if self.effect.id not in simple.contains:
                own = {
                    parameter.name: parameter.start_values(self._scale)[0] for parameter in simple.parameters
                }
                options.append(
                    _entry(simple, site, {**own, **{key: values[key] for key in own if key in values}})
                )
        return options

    def _value(self, parameter: EffectParameter, shape: float, factor: float) -> float:
        starts = parameter.start_values(self._scale)
        value = starts[self._start % len(starts)]
        if parameter.held:
            return value
        if parameter.neutral is None:
            value *= shape
        elif math.isinf(parameter.neutral):  # a level: the nearer to zero, the stronger
            value /= factor
        else:
            value *= factor
        low, high = parameter.bounds(self._scale)
        return float(min(max(value, low), high))


def _of_size(size: float, draw: Draw, site: str, rehearsal: Rehearsal) -> dict[str, Any] | None:
    """Return a drawn effect at the strength that shows with about this size; None if there is no such strength."""
    low, high = map(math.log, _FACTORS)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        hidden = _entry(draw.effect, site, draw.values(math.exp(middle)))
        case_size = rehearsal.size(hidden)
        if size / _CLOSE <= case_size <= size * _CLOSE:
            after_recalibration = rehearsal.recalibrated_size(hidden)
            separations = [rehearsal.apart(hidden, values) for values in draw.simpler(site, hidden["values"])]
            return (
                hidden
                if min([after_recalibration, *separations]) >= _SMALLEST / 2
                and after_recalibration <= 2 * size
                else None
            )
        low, high = (low, middle) if case_size > size else (middle, high)
    return None


def _parsed(text: str, scene: HidingScene) -> dict[str, Any]:
    """Return what ``EFFECT@SITE:name=value,...`` asks for."""
    name, at, rest = text.partition("@")
    site_name, _, given = rest.partition(":")
    if not (name and at and site_name):
        raise _expected(text)
    sites = [site for site in scene.places if site.name == site_name]
    if not sites:
        known = list(dict.fromkeys(site.name for site in scene.places))
        raise RequestError(
            f"--hide {text}: this scene has no site {site_name!r}",
            hint=suggest(site_name, known, kind="sites"),
        )
    refusals: list[str] = []
    for site in sites:
        try:
            effect = load_effect(name, site.kind)
            if not effect.fits(site):
                raise ModelError(
                    f"effect {name} needs the {' and the '.join(effect.needs)} at site {site_name}"
                )
            attached = effect.attach(site_name, scene.scale, **_values(text, given))
        except (ModelError, PluginError) as error:
            refusals.append(str(error))
        else:
            return _entry(effect, site_name, dict(attached.named_values))
    raise RequestError(f"--hide {text}: " + "; ".join(dict.fromkeys(refusals)))


def _expected(text: str) -> RequestError:
    return RequestError(
        f"--hide {text}: expected random, none, EFFECT@SITE, or PARAMETER=value",
        hint='for example --hide coulomb-friction@hinge, or --hide "delay@tail:delay=0.05"',
    )


def _parameter(text: str, scene: HidingScene, model: Model | None) -> dict[str, Any]:
    """Return what ``PARAMETER=value`` asks for."""
    name, equals, _ = text.partition("=")
    name = name.strip()
    if not equals:
        raise _expected(text)
    known = [*scene.truth().get("parameters", {})]
    if name not in known:
        raise RequestError(
            f"--hide {text}: this scene has no parameter {name!r}",
            hint=suggest(name, known, kind="parameters"),
        )
    units = {} if model is None else {parameter.name: parameter.unit for parameter in model.parameters}
    return {
        "effect": name, "site": name, "kind": PARAMETER, "values": _values(text, text),
        "units": {name: units.get(name, "1")},
    }  # fmt: skip


def _values(text: str, given: str) -> dict[str, float]:
    values = {}
    for item in filter(None, given.split(",")):
        name, equals, number = item.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            equals = ""
        if not equals or not math.isfinite(values[name.strip()]):
            raise RequestError(f"--hide {text}: {item!r} is not name=number, in SI units")
    return values


def _entry(effect: Effect, site: str, values: Mapping[str, float]) -> dict[str, Any]:
    return {"effect": effect.id, "site": site, "kind": effect.kind, "values": dict(values)}


def _outputs(sites: Iterable[Site]) -> list[str]:
    return [site.name for site in sites if site.kind == "output"]
