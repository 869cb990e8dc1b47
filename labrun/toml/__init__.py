"""One reader for all TOML of ours: positions, validation with all faults at once, nearest names, expressions."""

from labrun.toml.expressions import Expression, Operand, evaluate, fault_of, in_order, names_in, resolve
from labrun.toml.faults import (
    Fault,
    KeyPath,
    LocatedFault,
    Position,
    TableFaults,
    dotted,
    locate,
    refusal,
    replaced,
)
from labrun.toml.grammar import CONSTANTS, FUNCTIONS, RESERVED, ExpressionError
from labrun.toml.names import KNOWN_UNITS, UNITS, nearest, split_unit, suggest, unit_of
from labrun.toml.reading import Keys, Places, PluginTable, Table, checked, mend, parsed, text_of, validate
from labrun.toml.writing import written_in_order

__all__ = [
    "CONSTANTS", "FUNCTIONS", "KNOWN_UNITS", "RESERVED", "UNITS", "Expression", "ExpressionError", "Fault",
    "KeyPath", "Keys", "LocatedFault", "Operand", "Places", "PluginTable", "Position", "Table",
    "TableFaults", "checked", "dotted", "evaluate", "fault_of", "in_order", "locate", "mend", "names_in",
    "nearest", "parsed", "refusal", "replaced", "resolve", "split_unit", "suggest", "text_of",
    "unit_of", "validate", "written_in_order",
]  # fmt: skip
