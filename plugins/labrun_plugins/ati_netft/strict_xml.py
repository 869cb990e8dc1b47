"""XML from a device or from a calibration file: small, and without anything that a parser could be made to expand."""

import xml.parsers.expat
from dataclasses import dataclass, field

_DEEPEST = 16
_MOST_ELEMENTS = 5_000


class XmlRefusedError(ValueError):
    """What was read is not the plain XML it should be; the message says why."""


@dataclass
class Element:
    """One element: its name, attributes, text (without the white space around it) and children."""

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def find_all(self, name: str) -> list["Element"]:
        """Return all elements of this name below this one, whatever the case of its letters, at any depth."""
        found = []
        for child in self.children:
            if child.name.lower() == name.lower():
                found.append(child)
            found += child.find_all(name)
        return found


def parse(data: bytes, most_bytes: int) -> Element:
    """Return the root of an XML document.

    Raises
    ------
    XmlRefusedError
        Too long, too deep, not well-formed, or with a document type, an entity or a processing instruction.
    """
    if len(data) > most_bytes:
        raise XmlRefusedError(f"longer than {most_bytes} bytes")
    builder = _Builder()
    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.characters
    parser.StartDoctypeDeclHandler = builder.refuse
    parser.EntityDeclHandler = builder.refuse
    parser.ProcessingInstructionHandler = builder.refuse
    parser.ExternalEntityRefHandler = builder.refuse
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        raise XmlRefusedError(f"not well-formed: {error}") from None
    except (ValueError, LookupError) as error:  # an encoding nobody knows
        if isinstance(error, XmlRefusedError):
            raise
        raise XmlRefusedError(f"not readable: {error}") from None
    if builder.root is None:
        raise XmlRefusedError("empty")
    return builder.root


class _Builder:
    def __init__(self) -> None:
        self.root: Element | None = None
        self._open: list[Element] = []
        self._count = 0

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > _MOST_ELEMENTS or len(self._open) >= _DEEPEST:
            raise XmlRefusedError("more elements, or deeper ones, than such a file has")
        element = Element(name, attributes)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def end(self, _name: str) -> None:
        element = self._open.pop()
        element.text = element.text.strip()

    def characters(self, text: str) -> None:
        if self._open:
            self._open[-1].text += text

    def refuse(self, *_: object) -> int:
        raise XmlRefusedError(
            "it declares a document type, an entity or an instruction, which it has no need of"
        )
