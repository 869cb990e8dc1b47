"""What MuJoCo says of a file that it cannot read, for the person who wrote the file: where, and what was meant."""

import re
from pathlib import Path

from labrun.errors import ModelError
from labrun.models.mjcf.plant import imported
from labrun.toml import suggest

_REFERENCE = "what each element takes: https://mujoco.readthedocs.io/en/stable/XMLreference.html"
_MEANT = {
    "bad format": "numbers have a point, no comma, and a space between them",
    "Error opening file": "a file is looked for beside the one that names it: put it there, or leave the line out",
    "larger than mjMINVAL": "a body that a joint moves has a mass: give it <inertial> with pos, mass and diaginertia",
    "A + B >= C": "no body has such moments of inertia: none is more than the other two together; look at units",
}
"""What to do about complaints that name no word of the file."""
_SCHEMA_LINE = re.compile(r"^ *((?:\(world\))?\w+) \([!?*R]\) *(.*)$")
_CLOSED = re.compile(r"XML_ERROR_MISMATCHED_ELEMENT.* name=(\w+)")


def refusal(path: Path, error: ValueError, *, doing: str = "read") -> ModelError:
    """Return MuJoCo's complaint with the line first, and the nearest to a word that is known to nobody."""
    what, _, rest = str(error).strip().partition("\n")
    what = re.sub(r"^(XML )?Error: (Schema violation: )?", "", what)
    closed = _CLOSED.search(rest)
    if closed:
        what = f"<{closed[1]}> is not closed, or closed by another name"
    line = re.search(r"[Ll]ine(?: number=)? ?(\d+)", f"{rest} {what}")
    element = re.search(r"Element '([^']*)'", rest)
    where = f", line {line[1]}" if line else ""
    of = f" (element {element[1]})" if element else f" ({rest})" if rest and not line else ""
    return ModelError(f"MuJoCo cannot {doing} {path}{where}: {what}{of}", hint=_hint(path, what, element))


def _hint(path: Path, what: str, element: "re.Match[str] | None") -> str:
    attributes = _attributes()
    if element and "unrecognized element" in what:
        return suggest(element[1], attributes, kind="elements")
    wrong = re.search(r"'([^']+)'", what)
    if element and wrong and "unrecognized attribute" in what:
        return suggest(wrong[1], attributes.get(element[1], ()), kind=f"attributes of {element[1]}")
    if wrong and re.search(r"unknown|not found", what):
        text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
        names = dict.fromkeys(re.findall(r'\bname\s*=\s*"([^"]+)"', text))
        return suggest(wrong[1], names, kind="names in the file")
    return next((hint for part, hint in _MEANT.items() if part in what), _REFERENCE)


def _attributes() -> dict[str, list[str]]:
    """Return the attributes of every element that MuJoCo knows."""
    found: dict[str, list[str]] = {}
    last: list[str] = []
    for text in imported().mj_printSchema(False, False).splitlines():
        begun = _SCHEMA_LINE.match(text)
        if begun:
            last = found.setdefault(begun[1].removeprefix("(world)"), [])
            if begun[1].startswith("("):
                found["worldbody"] = last
        last += (begun[2] if begun else text).split()
    return found
