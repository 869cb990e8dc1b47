"""From the tables of an experiment file to references, feedbacks and controllers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from labrun import registry
from labrun.control.protocol import (
    Condition,
    Controller,
    ControllerPlugin,
    Feedback,
    FeedbackPlugin,
    LoopContext,
    Numbers,
    Reference,
    ReferencePlugin,
    Step,
    VectorController,
    VectorStep,
)
from labrun.errors import PluginError, SpecError
from labrun.experiment import LoopTable, named_channels, resolved_settings
from labrun.toml import PluginTable, suggest

REFERENCES = "labrun.references"
FEEDBACKS = "labrun.feedbacks"
CONTROLLERS = "labrun.controllers"


def make_reference(loop: str, table: PluginTable, condition: Condition) -> Reference:
    """Return the reference of a loop under a condition; SpecError on keys that do not hold."""
    plugin: ReferencePlugin = registry.load(REFERENCES, table.plugin)
    settings = _resolved(plugin, table, condition)
    return cast("Reference", _made(f"reference of loop {loop}", table, lambda: plugin(settings, condition)))


def make_references(
    loop: str, tables: Sequence[PluginTable], condition: Condition, count: int
) -> Callable[[float], Numbers]:
    """Return the reference of a loop under a condition, a number for each of its `count` components.

    Raises SpecError: keys that do not hold, or another number of components than the feedback has.
    """
    made = [make_reference(loop, table, condition) for table in tables]
    if len(tables) == 1 and getattr(registry.load(REFERENCES, tables[0].plugin), "several", False):
        several = cast("Callable[[float], Numbers]", made[0])
        size = len(several(0.0))
    else:
        size = len(made)

        def several(time_s: float) -> Numbers:
            return tuple([float(reference(time_s)) for reference in made])

    if size != count:
        raise SpecError(
            f"loop {loop}: its feedback is {_numbers(count)}, its reference {_numbers(size)}; a reference for each "
            "number of the feedback was expected",
            hint="give as many references as the feedback has numbers, in the same order",
        )
    return several


def _numbers(count: int) -> str:
    return "1 number" if count == 1 else f"{count} numbers"


def make_feedback(loop: str, table: PluginTable, units: Mapping[str, str]) -> Feedback:
    """Return the feedback of a loop; SpecError on keys that do not hold."""
    plugin: FeedbackPlugin = registry.load(FEEDBACKS, table.plugin)
    return cast("Feedback", _made(f"feedback of loop {loop}", table, lambda: plugin(table.settings, units)))


def make_controllers(
    loop: str, name: str, table: PluginTable, condition: Condition, context: LoopContext
) -> VectorController:
    """Return a controller of a loop under a condition, new.

    A controller of one number is made once for each component of the feedback, which then sets the drive of the same
    place. Raises SpecError: keys that do not hold, or a controller of one number with another number of drives than
    components.
    """
    plugin: ControllerPlugin = registry.load(CONTROLLERS, table.plugin)
    settings = _resolved(plugin, table, condition)
    what = f"controller {name} of loop {loop}"
    if getattr(plugin, "several", False):
        return cast("VectorController", _made(what, table, lambda: plugin(settings, context)))
    if len(context.components) != len(context.drives):
        raise SpecError(
            f'{what}: "{table.plugin}" answers for one number each, and {len(context.components)} numbers of '
            f"feedback are to set {len(context.drives)} variables",
            hint="give a feedback for each of the drives, or a controller of the whole loop",
        )
    return OneForEach([_made(what, table, lambda: plugin(settings, context)) for _ in context.drives])


class OneForEach:
    """One scalar controller per component of a loop."""

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self.controllers = controllers

    def update(self, step: VectorStep) -> Numbers:
        """Ask each of them."""
        return tuple(
            [
                float(controller.update(_part(step, number)))
                for number, controller in enumerate(self.controllers)
            ]
        )

    def applied(self, drives: Numbers) -> None:
        """Tell each of them."""
        for controller, drive in zip(self.controllers, drives, strict=True):
            controller.applied(drive)


def _part(step: VectorStep, number: int) -> Step:
    """Return the step of one component."""
    return Step(
        step.time_s,
        step.dt_s,
        step.reference[number],
        step.feedback[number],
        step.drives[number],
        lambda time_s: step.reference_at(time_s)[number],
    )


def controller_of(loop: str, table: LoopTable, condition: Condition) -> str:
    """Return the name of the controller that a condition puts in charge of a loop.

    A loop with a single controller needs no word of it in the condition. Raises SpecError: the condition names none
    that the loop has.
    """
    named = condition.get("controller")
    if isinstance(named, str) and named in table.controllers:
        return named
    if len(table.controllers) == 1:
        return next(iter(table.controllers))
    if named is None:
        raise SpecError(
            f"loop {loop} has {len(table.controllers)} controllers, and the condition says not which",
            hint=f'add controller = "{next(iter(table.controllers))}" to the condition',
        )
    raise SpecError(
        f'loop {loop} has no controller "{named}"',
        hint=suggest(str(named), table.controllers, kind="controllers"),
    )


def _resolved(plugin: Any, table: PluginTable, condition: Condition) -> dict[str, Any]:
    return resolved_settings(getattr(plugin, "Settings", None), table.settings, condition)


def _made(what: str, table: PluginTable, make: Any) -> Any:
    try:
        return make()
    except (SpecError, PluginError) as error:
        raise SpecError(f"{what}: {error}") from error
    except (TypeError, ValueError) as error:  # a third party's own way of refusing its keys
        raise SpecError(f'{what}: "{table.plugin}" refuses its keys: {error}') from error


def watched_by(table: PluginTable) -> list[str]:
    """Return the channels that a controller's keys name."""
    plugin = registry.load(CONTROLLERS, table.plugin)
    keys = getattr(plugin, "channel_settings", ())
    return [channel for key in keys for _, channel in named_channels(table.settings, key)]
