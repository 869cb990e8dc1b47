"""Effects that a bench has and its model lacks: in the model, and between command and joint."""

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices import FloatArray
from labrun.effects import AttachedEffect, Scale, load_effect
from labrun.errors import ExperimentError, ModelError, PluginError, SpecError
from labrun.models import Input, Model, Output, Stepper, load_model, natives
from labrun_plugins.simulated.bench.history import packed, unpacked
from labrun_plugins.simulated.bench.settings import HiddenEffect


def hidden_effects(wanted: Iterable[HiddenEffect], model: Model, scale: Scale) -> list[AttachedEffect]:
    """Return the effects at their sites of the model; values not given take their first start.

    Raises SpecError: no such site, or no such effect for its kind of site.
    """
    return [_attached(effect, model, scale) for effect in wanted]


def require_finite(stepper: Stepper, bench: str) -> None:
    """Raise ExperimentError where a bench, named in words, has left the finite numbers."""
    if not stepper.finite:
        raise ExperimentError(f"the simulation of {bench} diverged", hint="hide a weaker effect, or nothing")


def described(effect: AttachedEffect) -> dict[str, Any]:
    """Return an effect as JSON-ready values."""
    return {"effect": effect.effect.id, "site": effect.site, "values": dict(effect.named_values)}


@functools.cache
def model_beside(module_file: str, name: str) -> Model:
    """Return the model of a file that stands beside a bench's module, whose ``__file__`` is given."""
    return load_model(Path(module_file).with_name(name))


def _nothing(t: float, x: Any, u: Any, p: Any, force: Any, out: Any) -> None:
    """No state changes, and no site takes a force."""


def _pass_on(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output = input, as many as the first parameter says."""
    for i in range(int(p[0])):
        y[i] = u[i]


@functools.cache
def joint_model(joints: tuple[str, ...]) -> Model:
    """Return the model whose inputs and outputs are the joints' angles, rad."""
    return Model(
        name="joints",
        states=(),
        inputs=tuple(Input(joint, "rad") for joint in joints),
        outputs=tuple(Output(joint, "rad") for joint in joints),
        parameters=(),
        sites=(),
        initial={},
        **natives(_nothing, _pass_on, _nothing),
        constants=np.array([float(len(joints))]),
        source="joints of a simulated bench",
    )


def joint_stepper(joints: tuple[str, ...], step_s: float, effects: Sequence[AttachedEffect] = ()) -> Stepper:
    """Return what turns commanded into true joint angles, with the effects that hide there."""
    return Stepper(joint_model(joints), effects=effects, step_s=step_s)


def _attached(wanted: HiddenEffect, model: Model, scale: Scale) -> AttachedEffect:
    places = [site for site in model.places if site.name == wanted.site and wanted.kind in (None, site.kind)]
    if not places:
        known = ", ".join(dict.fromkeys(location.name for location in model.places))
        raise SpecError(f"rig.scene.hide: this bench has no site {wanted.site!r}", hint=f"it has {known}")
    refusals = []
    for site in places:
        try:
            effect = load_effect(wanted.effect, site.kind)
            attached = effect.attach(wanted.site, scale, **wanted.values)
            attached.check(model)
        except (PluginError, ModelError) as error:
            refusals.append(str(error))
        else:
            return attached
    raise SpecError(
        f"rig.scene.hide: {wanted.effect!r} at {wanted.site!r}: " + "; ".join(dict.fromkeys(refusals))
    )


class Passage:
    """Signals on their way into a bench or out of it, through the effects that hide there; without any they stay.

    Parameters
    ----------
    names
        Of the signals: joints or what is sensed.
    wanted
        The effects that hide at these names.
    before : (signals,)
        Where the signals are before the first; zero if None.
    """

    def __init__(
        self, names: tuple[str, ...], wanted: Sequence[HiddenEffect], scale: Scale, step_s: float,
        before: FloatArray | None = None,
    ) -> None:  # fmt: skip
        self.effects = hidden_effects(wanted, joint_model(names), scale)
        self._stepper = joint_stepper(names, step_s, self.effects) if self.effects else None
        self._before = np.zeros((1, len(names))) if before is None else before[None, :]

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return the next values, (n,) of one signal or (n, signals), after the effects."""
        if self._stepper is None:
            return values
        rows = values.reshape(len(values), -1)
        passed = self._stepper.advance(np.concatenate([self._before, rows]))
        self._before = rows[-1:].copy()
        return np.asarray(passed).reshape(values.shape)

    def snapshot(self) -> dict[str, Any] | None:
        """Return its memory, JSON-ready."""
        if self._stepper is None:
            return None
        return {"before": packed(self._before), "stepper": self._stepper.snapshot()}

    def restore(self, stored: dict[str, Any] | None) -> None:
        """Take back what `snapshot` gave."""
        if self._stepper is not None and stored is not None:
            self._before = unpacked(stored["before"])
            self._stepper.restore(stored["stepper"])
