"""The tables of a model file, and its reader, which reports all faults together."""

# ruff: noqa: RUF012 - pydantic copies defaults

import keyword
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NoReturn, TypeVar

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from labrun.effects import SiteKind
from labrun.errors import ModelError, RequestError
from labrun.models.model import Between
from labrun.toml import (
    RESERVED,
    Expression,
    ExpressionError,
    Fault,
    KeyPath,
    Places,
    Table,
    TableFaults,
    fault_of,
    parsed,
    refusal,
    validate,
)

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_SHOWN = 90


def is_name(text: str) -> bool:
    """Tell whether equations can use a name."""
    return _NAME.match(text) is not None and not keyword.iskeyword(text)


def _usable(name: str) -> str:
    if not is_name(name):
        raise ValueError(
            f"equations cannot use the name {name!r}: expected letters, digits and _, and no Python keyword"
        )
    if name in RESERVED:
        raise ValueError(f"{name!r} is reserved in equations; choose another name")
    return name


def _each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise ValueError(f"duplicate name in {list(names)}")
    return names


def listed(value: Any) -> Any:
    """Take a list of names for tables that say nothing more of each."""
    if isinstance(value, list) and all(isinstance(entry, str) for entry in value):
        return {name: {} for name in _each_once(tuple(value))}
    if not isinstance(value, dict):
        raise ValueError('expected a list of names, ["torque"], or a table for each')
    return value


def alone(key: str) -> BeforeValidator:
    """Take a value that stands alone for a table with this key."""
    return BeforeValidator(lambda value: value if isinstance(value, dict) else {key: value})


def numeric(expression: Expression) -> Expression:
    """Refuse what no model computes with. Raises PydanticCustomError: words in quotes, or names that are not plain."""
    problem = _strange(expression)
    if problem is not None:
        raise PydanticCustomError("expression", "{text}", {"text": fault_of(problem)})
    return expression


def _strange(expression: Expression) -> ExpressionError | None:
    for word, position in expression.words.items():
        return ExpressionError(expression.text, f"a model has no words such as {word!r}", position)
    for name, position in expression.names.items():
        if not name.isascii():
            return ExpressionError(expression.text, f"{name!r} has a letter that is not plain", position)
    return None


Name = Annotated[str, AfterValidator(_usable)]
Names = Annotated[tuple[Name, ...], AfterValidator(_each_once)]
Equation = Annotated[Expression, AfterValidator(numeric)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Bounded(Table):
    """Prior and bounds of a parameter."""

    model_config = ConfigDict(allow_inf_nan=True)

    value: Finite | None = None
    tolerance: Annotated[float, Field(ge=0, allow_inf_nan=False)] | Literal["free"] = "free"
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf

    @model_validator(mode="after")
    def _value_inside(self) -> "Bounded":
        with TableFaults() as faults:
            if self.value is not None and not self.lower <= self.value <= self.upper:
                outside = (
                    f"the value {self.value:g} is outside of its bounds {self.lower:g} to {self.upper:g}"
                )
                faults.add(None, outside)
        return self


class ParameterTable(Bounded):
    """A parameter of a model with equations."""

    value: Finite


class MujocoParameter(Bounded):
    """A parameter that may stand for a number of the MJCF file, which then is its value."""

    mjcf: str = ""


class InputTable(Table):
    """An input."""

    unit: str = "1"
    between: Between = "linear"
    prescribed: bool = False


class MujocoInput(InputTable):
    """An input and the element it drives."""

    mjcf: str


class OutputTable(Table):
    """An output and its equation."""

    equation: Equation
    unit: str = "1"


class MujocoOutput(Table):
    """An output and the quantity it shows."""

    mjcf: str
    unit: str = "1"


class SiteTable(Table):
    """A joint or a body, or the base, the tip or a link of a robot."""

    kind: Literal["joint", "body", "base", "tip", "link", "controller"]
    coordinate: Equation
    rate: Equation
    load: Equation = Expression.of(0.0)
    stiffness: Equation = Expression.of(0.0)
    drive: bool = False
    unit: Literal["", "rad", "m"] = ""

    def text(self, quantity: str) -> str:
        """Return an equation as written in the file; "" if absent."""
        return str(getattr(self, quantity).text) if quantity in self.model_fields_set else ""


class MujocoSite(Table):
    """A joint of the MJCF file; that of the site's own name where it names none."""

    kind: Literal["joint", "body"] = "joint"
    joint: str | None = None
    stiffness: Equation = Expression.of(0.0)
    load: Equation = Expression.of(0.0)
    drive: bool = False


class ConditionTable(Table):
    """What a condition means to equations where a trial says it in a word, or does not say it."""

    of: Name | None = None
    words: dict[str, Finite] = {}
    default: Finite | str | None = None

    @model_validator(mode="after")
    def _default_known(self) -> "ConditionTable":
        with TableFaults() as faults:
            if isinstance(self.default, str) and self.default not in self.words:
                faults.add("default", f"no number is stated for the word {self.default!r}")
        return self


class EffectTable(Table):
    """Physics that a model carries with it."""

    model_config = ConfigDict(allow_inf_nan=True)

    effect: str
    site: str
    kind: SiteKind | None = None
    values: dict[str, float] = {}


class CorrectedTable(Table):
    """Which model a corrected one comes from, and from which data."""

    source: str = Field(alias="from")
    by: str = ""


class SystemFile(Table):
    """Keys of every model file with a system of its own."""

    name: Annotated[str, Field(min_length=1)]
    title: str = ""
    corrected: CorrectedTable | None = None
    conditions: Annotated[dict[Name, ConditionTable], BeforeValidator(listed)] | None = None
    initial: dict[str, float | str] = {}
    effects: tuple[EffectTable, ...] = ()


class EquationsFile(SystemFile):
    """A model file with equations."""

    states: Names = ()
    inputs: Annotated[dict[Name, InputTable], BeforeValidator(listed)] = {}
    parameters: dict[Name, Annotated[ParameterTable, alone("value")]] = {}
    where: dict[Name, Equation] = {}
    equations: dict[str, Equation] = {}
    outputs: Annotated[dict[Name, Annotated[OutputTable, alone("equation")]], Field(min_length=1)]
    sites: dict[Name, SiteTable] = {}


class MujocoFile(SystemFile):
    """A model file with a ``mujoco`` key."""

    mujoco: str
    states: dict[Name, str] = {}
    inputs: dict[Name, Annotated[MujocoInput, alone("mjcf")]] = {}
    parameters: dict[Name, Annotated[MujocoParameter, alone("value")]] = {}
    mjcf: dict[str, Equation] = {}
    outputs: Annotated[dict[Name, Annotated[MujocoOutput, alone("mjcf")]], Field(min_length=1)]
    sites: dict[Name, MujocoSite] = {}


class BasedFile(Table):
    """A model file that changes another model."""

    base: str
    name: str | None = None
    title: str = ""
    corrected: CorrectedTable | None = None
    values: dict[str, Finite] = {}
    initial: dict[str, float | str] = {}
    effects: tuple[EffectTable, ...] = ()


FileTable = TypeVar("FileTable", bound=Table)


class ModelFile:
    """A model file while it is read.

    `name`: what it is called in messages; a path in it is counted from its folder. `text`: its content. Raises
    ModelError: it is not TOML.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.data: Mapping[str, Any] = parsed(text, name, kind=ModelError)
        self._places = Places(name, text, self.data)
        self._faults: list[Fault] = []

    def read(self, model: type[FileTable]) -> FileTable:
        """Return its tables. Raises ModelError: all keys that do not hold."""
        value, faults = validate(model, self.data)
        self._faults += [self._with_caret(fault) for fault in faults]
        self.refuse()
        assert value is not None  # noqa: S101 - else there were faults
        return value

    def note(self, path: KeyPath, message: str, hint: str | None = None, *, at_value: bool = False) -> None:
        """Keep a fault until `refuse`."""
        self._faults.append(Fault(path, f"{message}; {hint}" if hint else message, at_value))

    def note_in(self, path: KeyPath, problem: ExpressionError) -> None:
        """Keep a fault of an equation, with a caret below its place."""
        text = re.sub(r"\s", " ", problem.text)
        start = max(0, min(problem.position - _SHOWN // 2, len(text) - _SHOWN))
        cut = text[start : start + _SHOWN]
        lead = "..." if start else ""
        tail = "..." if start + _SHOWN < len(text) else ""
        below = " " * (problem.position - start + len(lead))
        self.note(path, f"{fault_of(problem)}\n    {lead}{cut}{tail}\n    {below}^", at_value=True)

    def fail(self, path: KeyPath, message: str, hint: str | None = None) -> NoReturn:
        """Refuse the file at once, for a fault without which nothing else can be looked at."""
        self.note(path, message, hint)
        raise self._refusal()

    def refuse(self) -> None:
        """Raise `ModelError` if anything was wrong."""
        if self._faults:
            raise self._refusal()

    def line_of(self, path: KeyPath) -> int | None:
        """Return the line of a key."""
        return self._places.of_all([Fault(path, "")])[0].line

    def _refusal(self) -> RequestError:
        return refusal(ModelError, self.name, self._places.of_all(self._faults))

    def _with_caret(self, fault: Fault) -> Fault:
        value = self._places.value(fault.path)
        try:
            problem = _strange(Expression.of(value)) if isinstance(value, str) and fault.at_value else None
        except ExpressionError as error:
            problem = error
        if problem is None or fault_of(problem) != fault.message:
            return fault
        self.note_in(fault.path, problem)
        return self._faults.pop()
