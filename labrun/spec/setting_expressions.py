"""Settings of a plugin whose numbers may be expressions in the names of a condition: gains that are swept."""

from collections.abc import Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel

from labrun.toml import Operand, evaluate


def is_expression(model: type[BaseModel], key: str, value: object) -> bool:
    """Tell whether a setting is an expression: text where the plugin takes a number and no text."""
    field = model.model_fields.get(key)
    if field is None or not isinstance(value, str):
        return False
    kinds = set(_kinds(field.annotation))
    return bool(kinds & {int, float}) and str not in kinds


def resolved_settings(
    model: type[BaseModel] | None, settings: Mapping[str, Any], names: Mapping[str, Operand]
) -> dict[str, Any]:
    """Return settings with every expression computed from the values of a condition.

    Raises
    ------
    ExpressionError
        An expression cannot be read or computed.
    """
    if model is None:
        return dict(settings)
    return {
        key: evaluate(value, names) if is_expression(model, key, value) else value
        for key, value in settings.items()
    }


def _kinds(annotation: Any) -> Iterator[type]:
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _kinds(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _kinds(member)
    elif isinstance(annotation, type):
        yield annotation
