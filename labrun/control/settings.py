"""Keys of references, feedbacks and controllers: checked, none unknown."""

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from pydantic import BaseModel, ConfigDict

from labrun.errors import SpecError
from labrun.toml import dotted, validate


class ControlSettings(BaseModel):
    """Keys of a plugin of a loop."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


SettingsType = TypeVar("SettingsType", bound=BaseModel)


def checked(model: type[SettingsType], settings: Mapping[str, Any]) -> SettingsType:
    """Return settings as their model.

    Raises
    ------
    SpecError
        All keys that do not hold.
    """
    found, problems = validate(model, settings)
    if problems:
        raise SpecError("; ".join(f"{dotted(item.path)}: {item.message}" for item in problems))
    return cast("SettingsType", found)
