"""From the tables of an experiment file to references, feedbacks and controllers."""

from collections.abc import Mapping
from typing import Any, cast

from labrun import registry
from labrun.control.protocol import (
    Condition,
    Controller,
    ControllerPlugin,
    Feedback,
    FeedbackPlugin,
    LoopContext,
    Reference,
    ReferencePlugin,
)
from labrun.errors import SpecError
from labrun.spec import LoopTable, resolved_settings
from labrun.toml import PluginTable, suggest

REFERENCES = "labrun.references"
FEEDBACKS = "labrun.feedbacks"
CONTROLLERS = "labrun.controllers"


def make_reference(loop: str, table: PluginTable, condition: Condition) -> Reference:
    """Return the reference of a loop under a condition; SpecError on keys that do not hold."""
    plugin: ReferencePlugin = registry.load(REFERENCES, table.plugin)
    settings = _resolved(plugin, table, condition)
    return cast("Reference", _made(f"reference of loop {loop}", table, lambda: plugin(settings, condition)))


def make_feedback(loop: str, table: PluginTable, units: Mapping[str, str]) -> Feedback:
    """Return the feedback of a loop; SpecError on keys that do not hold."""
    plugin: FeedbackPlugin = registry.load(FEEDBACKS, table.plugin)
    return cast("Feedback", _made(f"feedback of loop {loop}", table, lambda: plugin(table.settings, units)))


def make_controller(
    loop: str, name: str, table: PluginTable, condition: Condition, context: LoopContext
) -> Controller:
    """Return a controller of a loop under a condition, new; SpecError on keys that do not hold."""
    plugin: ControllerPlugin = registry.load(CONTROLLERS, table.plugin)
    settings = _resolved(plugin, table, condition)
    return cast(
        "Controller", _made(f"controller {name} of loop {loop}", table, lambda: plugin(settings, context))
    )


def controller_of(loop: str, table: LoopTable, condition: Condition) -> str:
    """Return the name of the controller that a condition puts in charge of a loop.

    A loop with a single controller needs no word of it in the condition.

    Raises
    ------
    SpecError
        The condition names none that the loop has.
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
    except SpecError as error:
        raise SpecError(f"{what}: {error}") from error
    except (TypeError, ValueError) as error:  # a third party's own way of refusing its keys
        raise SpecError(f'{what}: "{table.plugin}" refuses its keys: {error}') from error
