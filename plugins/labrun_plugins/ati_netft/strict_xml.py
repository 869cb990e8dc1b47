"""XML from a device or from a calibration file: small, and without anything that a parser could be made to expand."""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element


class XmlRefusedError(ValueError):
    """What was read is not the plain XML it should be; the message says why."""


class _Plain(ElementTree.TreeBuilder):
    """Builds a tree, and refuses what such a file has no need of."""

    def doctype(self, *_: object) -> None:
        raise XmlRefusedError("it declares a document type or an entity, which it must not contain")

    def pi(self, *_: object) -> Element:
        raise XmlRefusedError("it holds an instruction, which it must not contain")


def parse(data: bytes, most_bytes: int) -> Element:
    """Return the root of an XML document.

    Raises XmlRefusedError: too long, not well-formed, or with a document type, an entity or a processing instruction.
    """
    if len(data) > most_bytes:
        raise XmlRefusedError(f"longer than {most_bytes} bytes")
    try:
        return ElementTree.fromstring(data, ElementTree.XMLParser(target=_Plain()))  # noqa: S314  see `_Plain`
    except XmlRefusedError:
        raise
    except ElementTree.ParseError as error:
        raise XmlRefusedError(f"not well-formed: {error}") from None
    except (ValueError, LookupError) as error:  # an encoding nobody knows
        raise XmlRefusedError(f"not readable: {error}") from None


def find_all(root: Element, name: str) -> list[Element]:
    """Return all elements of this name below the root, whatever the case of its letters, at any depth."""
    return [element for element in root.iter() if element is not root and element.tag.lower() == name.lower()]
