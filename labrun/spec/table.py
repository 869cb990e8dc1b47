"""What all tables of an experiment file have in common."""

from typing import Any

from pydantic import BaseModel, ConfigDict

Number = float | int
Expression = float | str
"""A number, or an expression in the names of conditions, variables and `let`."""


class Table(BaseModel):
    """A table of the file: unknown keys are errors, values do not change."""

    # Strict: TOML has types of its own, and `repeats = "3"` is a slip of the pen, not a number.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PluginTable(BaseModel):
    """A table that names a plugin; its further keys belong to the plugin, which checks them."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    plugin: str

    @property
    def settings(self) -> dict[str, Any]:
        """The plugin's own keys."""
        return dict(self.model_extra or {})
