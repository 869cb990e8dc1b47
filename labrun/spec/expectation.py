"""What pydantic expected, in the words of the file."""

from pydantic_core import ErrorDetails

from labrun.nearest import nearest
from labrun.spec.names import unit_of
from labrun.spec.problem import shown
from labrun.toml_positions import KeyPath

_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "list_type": "a list [...]",
    "tuple_type": "a list [...]",
    "dict_type": "a table { ... }",
    "mapping_type": "a table { ... }",
    "model_type": "a table { ... }",
    "model_attributes_type": "a table { ... }",
    "finite_number": "a finite number",
    "none_required": "nothing",
}
_BOUNDS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}
_LENGTHS = {"too_short": ("at least", "min_length"), "too_long": ("at most", "max_length")}
_NUMBERS = ("int_type", "float_type", "int_from_float")


def expectation(error: ErrorDetails, path: KeyPath) -> str:
    """Return what was expected at a key, with bound and unit: "more than 0 s"."""
    kind, context = error["type"], error.get("ctx", {})
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    unit = unit_of(key)
    tail = f" {unit}" if unit else ""
    if kind in _BOUNDS:
        words, name = _BOUNDS[kind]
        return f"{words} {context[name]:g}{tail}"
    if kind == "literal_error":
        choices = [
            str(choice) for choice in context["expected"].replace("'", '"').replace(" or ", ", ").split(", ")
        ]
        near = nearest(str(error["input"]), [choice.strip('"') for choice in choices])
        return " or ".join(choices) + (f' (did you mean "{near}"?)' if near else "")
    if kind in _LENGTHS:
        words, name = _LENGTHS[kind]
        return f"{words} {context[name]} " + ("entry" if context[name] == 1 else "entries")
    if kind in _EXPECTED:
        return _EXPECTED[kind] + (f" ({unit})" if unit and kind in _NUMBERS else "")
    if kind == "value_error":  # a plugin's own validator, in its own words
        return error["msg"].removeprefix("Value error, ")
    return f"{error['msg'][:1].lower()}{error['msg'][1:]}, not {shown(error['input'])}"
