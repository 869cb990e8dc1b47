"""What all tables of an experiment file have in common."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from labrun.toml import Table

__all__ = ["Expression", "Number", "PluginTable", "Table"]

Number = float | int
Expression = float | str
"""A number, or an expression in the names of conditions, variables and `let`."""


class PluginTable(BaseModel):
    """A table that names a plugin; its further keys belong to the plugin, which checks them."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

    plugin: str

    @property
    def settings(self) -> dict[str, Any]:
        """The plugin's own keys."""
        return dict(self.model_extra or {})
