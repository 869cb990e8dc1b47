"""The experiment as its dry run carries it out, with what is hidden; never what is stored."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from labrun.devices import Scene
from labrun.effects import Scale
from labrun.errors import RequestError
from labrun.models import Site
from labrun.runner import Rig, SimulatedClock
from labrun.spec import Experiment, SceneTable

PARAMETER = "parameter"
"""Kind of what is hidden that is no effect: a parameter's true value."""
_KEYS = ("effect", "site", "kind", "values")


class HidingScene(Scene, Protocol):
    """A simulated bench that can hide effects."""

    scale: Scale
    """Typical magnitudes on the bench."""

    @property
    def places(self) -> Sequence[Site]:
        """Where it can hide them: the joints that are driven, the bodies, the signals."""
        ...


def concealed(
    experiment: Experiment,
    hidden: Sequence[Mapping[str, Any]],
    *,
    noise: float | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Experiment:
    """Return an experiment whose scene is what its model says, but for what it hides.

    Parameters
    ----------
    hidden
        Effects and true values of parameters, see `labrun.blind.hiding.choose_hidden`.
    noise
        Instead of the scene's own factor.
    parameters
        Relative errors of the scene's parameters, in addition to its own.

    Raises
    ------
    RequestError
        The experiment has no scene.
    """
    scene = _named_scene(experiment)
    settings: dict[str, Any] = {
        **scene.settings,
        "hide": [{key: one[key] for key in _KEYS} for one in hidden if one["kind"] != PARAMETER],
        "as_modelled": True,
    }
    if noise is not None:
        settings["noise"] = noise
    if parameters:
        own = settings.get("parameters", {})
        settings["parameters"] = {
            **own, **{name: (1 + own.get(name, 0.0)) * (1 + error) - 1 for name, error in parameters.items()}
        }  # fmt: skip
    true = {
        name: value for one in hidden if one["kind"] == PARAMETER for name, value in one["values"].items()
    }
    if true:
        settings["true_parameters"] = {**settings.get("true_parameters", {}), **true}
    table = SceneTable.model_validate({"plugin": scene.plugin, **settings})
    return experiment.model_copy(update={"rig": experiment.rig.model_copy(update={"scene": table})})


def hiding_scene(experiment: Experiment) -> HidingScene:
    """Return the scene of an experiment. Raises RequestError: it names none, or one that cannot hide anything."""
    name = _named_scene(experiment).plugin
    rig = Rig.build(concealed(experiment, []), clock=SimulatedClock(), seed=0, dry_run=True)
    scene: Any = rig.scene
    if not (hasattr(scene, "places") and hasattr(scene, "scale")):
        raise RequestError(f"scene {name!r} cannot hide effects: it names no sites")
    found: HidingScene = scene
    return found


def _named_scene(experiment: Experiment) -> SceneTable:
    if experiment.rig.scene is None:
        raise RequestError(
            "there is no simulated bench to hide an effect in",
            hint='name one: [rig] scene = "..."; the plain one has no physics',
        )
    return experiment.rig.scene
