"""Results as JSON has them: it has no word for what is not finite."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any


def finite(value: Any) -> Any:
    """Return a value as JSON has it, all the way down: a dataclass by its fields, None for what is not finite."""
    if is_dataclass(value) and not isinstance(value, type):
        return finite({field.name: getattr(value, field.name) for field in fields(value)})
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
