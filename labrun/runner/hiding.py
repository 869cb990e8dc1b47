"""What a dry run hides: chosen by the person, or drawn so that nobody knows it."""

import math
import secrets
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.errors import RequestError
from labrun.runner.concealment import PARAMETER
from labrun.runner.rehearsal import HidingScene, Rehearsal, hiding_scene
from labrun.toml import nearest

if TYPE_CHECKING:
    from labrun.effects import Effect, EffectParameter, Scale
    from labrun.models import Model, Site
    from labrun.spec.experiment import Experiment, Value

Condition = Mapping[str, "Value"]

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


def choose_hidden(
    wanted: Sequence[str],
    experiment: "Experiment",
    model: "Model | None",
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
        What will be compared with the run; what is drawn is at a site that it knows. Needed for ``"random"``.
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
    scene = hiding_scene(experiment)
    units = _units(scene, model)
    if NONE in wanted or RANDOM in wanted:
        if len(wanted) > 1:
            raise RequestError(f"--hide {NONE if NONE in wanted else RANDOM} stands alone")
        if NONE in wanted:
            return []
        if model is None:
            raise RequestError(
                "--hide random draws among what the experiment's model could lack, and it names no model",
                hint='give its file a table [gap] with model = "..."',
            )
        rng = np.random.default_rng(secrets.randbits(128) if seed is None else seed)
        return [_with_units(one, units) for one in _drawn(experiment, scene, model, conditions, rng)]
    return [
        _with_units(_parsed(text, scene), units) if "@" in text else _parameter(text, scene, model)
        for text in wanted
    ]


def _drawn(
    experiment: "Experiment",
    scene: HidingScene,
    model: "Model",
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


def candidates(scene: HidingScene, model: "Model", *, tared: bool) -> list[tuple["Effect", "Site"]]:
    """Return every installed effect at every site that scene and model both have, and at which it can do something."""
    from labrun.effects import effects

    ours, theirs = list(scene.places), list(model.places)
    same_order = _outputs(ours) == _outputs(theirs)
    found = []
    for site in theirs:
        twin = next((one for one in ours if (one.name, one.kind) == (site.name, site.kind)), None)
        if twin is None:
            continue
        for effect in effects():
            if not (effect.fits(site) and effect.fits(twin)):
                continue
            if effect.signals > 1 and not (same_order and len(_outputs(theirs)) >= effect.signals):
                continue  # what the next signal is depends on the order of all
            if effect.needs_acceleration and site.rate not in model.states:
                continue  # the model could not say what the acceleration is
            if effect.id == "drift" and not tared:
                continue  # it runs for as long as the run: without a tare it would be a step between trials
            found.append((effect, site))
    return found


class Draw:
    """One drawn effect whose strength is still open: the shape of its values, and where its sizes start.

    Parameters
    ----------
    scale
        Typical magnitudes on the bench.
    rng
        Draws the sign and the shape.
    """

    def __init__(self, effect: "Effect", scale: "Scale", rng: np.random.Generator) -> None:
        self.effect = effect
        self._scale = scale
        self._start = int(rng.integers(max(len(one.starts) for one in effect.parameters)))
        spread = math.log(_SHAPE_SPREAD)
        self._shape = [math.exp(rng.uniform(-spread, spread)) for _ in effect.parameters]

    def values(self, factor: float) -> dict[str, float]:
        """Return values of a strength; 1 is where a search for the effect would start."""
        return {
            one.name: self._value(one, shape, factor)
            for one, shape in zip(self.effect.parameters, self._shape, strict=True)
        }

    def _value(self, one: "EffectParameter", shape: float, factor: float) -> float:
        starts = one.start_values(self._scale)
        value = starts[self._start % len(starts)]
        if one.held:
            return value
        if one.neutral is None:
            value *= shape
        elif math.isinf(one.neutral):  # a level: the nearer to zero, the stronger
            value /= factor
        else:
            value *= factor
        low, high = one.bounds(self._scale)
        return float(min(max(value, low), high))


def _of_size(size: float, draw: Draw, site: str, rehearsal: Rehearsal) -> dict[str, Any] | None:
    """Return a drawn effect at the strength that shows with about this size; None if there is no such strength."""
    low, high = map(math.log, _FACTORS)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        hidden = _entry(draw.effect, site, draw.values(math.exp(middle)))
        found = rehearsal.size(hidden)
        if size / _CLOSE <= found <= size * _CLOSE:
            left = rehearsal.recalibrated_size(hidden)
            return hidden if _SMALLEST / 2 <= left <= 2 * size else None
        low, high = (low, middle) if found > size else (middle, high)
    return None


def _parsed(text: str, scene: HidingScene) -> dict[str, Any]:
    """Return what ``EFFECT@SITE:name=value,...`` asks for."""
    from labrun.effects import load_effect
    from labrun.errors import ModelError, PluginError

    name, at, rest = text.partition("@")
    site_name, _, given = rest.partition(":")
    if not (name and at and site_name):
        raise RequestError(
            f"--hide {text}: expected random, none, EFFECT@SITE, or PARAMETER=value",
            hint='for example --hide coulomb-friction@hinge, or --hide "delay@tail:delay=0.05"',
        )
    sites = [site for site in scene.places if site.name == site_name]
    if not sites:
        known = list(dict.fromkeys(site.name for site in scene.places))
        near = nearest(site_name, known)
        raise RequestError(
            f"--hide {text}: this scene has no site {site_name!r}",
            hint=f"did you mean {near!r}?" if near else f"it has {', '.join(known)}",
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


def _parameter(text: str, scene: HidingScene, model: "Model | None") -> dict[str, Any]:
    """Return what ``PARAMETER=value`` asks for."""
    name, equals, _ = text.partition("=")
    name = name.strip()
    if not equals:
        raise RequestError(
            f"--hide {text}: expected random, none, EFFECT@SITE, or PARAMETER=value",
            hint='for example --hide coulomb-friction@hinge, or --hide "delay@tail:delay=0.05"',
        )
    known = [*scene.truth().get("parameters", {})]
    if name not in known:
        near = nearest(name, known)
        raise RequestError(
            f"--hide {text}: this scene has no parameter {name!r}",
            hint=f"did you mean {near!r}?" if near else f"it has {', '.join(known) or 'none'}",
        )
    units = {} if model is None else {one.name: one.unit for one in model.parameters}
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


def _entry(effect: "Effect", site: str, values: Mapping[str, float]) -> dict[str, Any]:
    return {"effect": effect.id, "site": site, "kind": effect.kind, "values": dict(values)}


def _with_units(one: dict[str, Any], signals: Mapping[str, str]) -> dict[str, Any]:
    from labrun.effects import load_effect

    signal = signals.get(one["site"], "1")
    parameters = load_effect(one["effect"], one["kind"]).parameters
    return {**one, "units": {parameter.name: parameter.unit("rad", signal) for parameter in parameters}}


def _units(scene: HidingScene, model: "Model | None") -> dict[str, str]:
    units = dict(scene.signals)
    if model is not None:
        units |= {one.name: one.unit for one in model.inputs} | {one.name: one.unit for one in model.outputs}
    return units


def _outputs(sites: Iterable["Site"]) -> list[str]:
    return [site.name for site in sites if site.kind == "output"]
