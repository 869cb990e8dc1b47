"""A formula in time."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.control.protocol import Condition
from labrun.toml import Table, checked, evaluate


class FormulaSettings(Table):
    """Key of `formula`: the value, an expression in ``t`` (s of the trial) and the names of the condition."""

    value: float | str


class FormulaReference:
    """A formula in ``t``, for what has no name of its own."""

    Settings: ClassVar[type[Table]] = FormulaSettings
    names: ClassVar[tuple[str, ...]] = ("t",)
    expression_settings: ClassVar[tuple[str, ...]] = ("value",)

    def __init__(self, settings: Mapping[str, Any], condition: Condition) -> None:
        self._value = checked(FormulaSettings, settings).value
        self._names = dict(condition)

    def __call__(self, time_s: float) -> float:
        """Return the value at a time of the trial.

        Raises
        ------
        ExpressionError
            The formula gives no finite number there.
        """
        return float(evaluate(self._value, {**self._names, "t": time_s}))
