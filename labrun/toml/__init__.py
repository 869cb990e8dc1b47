"""One reader for all TOML of ours: positions, validation with all faults at once, nearest names, expressions."""

from labrun.toml.expressions import Expression, Operand, evaluate, fault_of, in_order, names_in, resolve
from labrun.toml.faults import (
    Fault,
    KeyPath,
    LocatedFault,
    Position,
    Positions,
    TableFaults,
    dotted,
    locate,
    refusal,
    replaced,
    shown,
)
from labrun.toml.grammar import CONSTANTS, FUNCTIONS, RESERVED, ExpressionError
from labrun.toml.names import KNOWN_UNITS, UNITS, nearest, split_unit, suggest, unit_of
from labrun.toml.reading import Places, parsed, read, text_of
from labrun.toml.validation import PluginTable, Table, checked, mend, validate

__all__ = [
    "CONSTANTS", "FUNCTIONS", "KNOWN_UNITS", "RESERVED", "UNITS", "Expression", "ExpressionError", "Fault",
    "KeyPath", "LocatedFault", "Operand", "Places", "PluginTable", "Position", "Positions", "Table",
    "TableFaults", "checked", "dotted", "evaluate", "fault_of", "in_order", "locate", "mend", "names_in",
    "nearest", "parsed", "read", "refusal", "replaced", "resolve", "shown", "split_unit", "suggest", "text_of",
    "unit_of", "validate",
]  # fmt: skip
