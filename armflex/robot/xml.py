"""Safe reading of XML: size and depth caps, no DTD, no entities, a line number for every element."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from armflex.errors import Place, UrdfError
from armflex.printable import unprintable

MAX_BYTES = 5_000_000
MAX_DEPTH = 64


def parse_xml(path: Path) -> etree._Element:
    """Return the root element of an XML file.

    Raises:
        UrdfError: The file is missing, empty, larger than `MAX_BYTES`, not UTF-8, truncated, deeper than
            `MAX_DEPTH`, has a text that cannot be shown, or a document type definition (entities could read files or
            explode).
    """
    data = _read(path)
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise UrdfError(Place(path, error.lineno or 0), f"not well-formed XML: {error.msg}") from None
    if root.getroottree().docinfo.doctype:  # pyright: ignore[reportAttributeAccessIssue] - lxml has it, its stubs not
        raise UrdfError(Place(path, 1), "has a document type definition (DTD); entities are refused")
    _check_elements(root, path)
    return root


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UrdfError(Place(path), f"is {path.stat().st_size} bytes, more than the {MAX_BYTES} allowed")
        data = path.read_bytes()
    except OSError as error:
        raise UrdfError(Place(path), f"cannot be read: {error.strerror}") from None
    if not data.strip():
        raise UrdfError(Place(path), "is empty")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise UrdfError(Place(path), "is not UTF-8 text (binary or UTF-16?)") from None
    if "\0" in text:
        raise UrdfError(Place(path), "holds NUL characters: binary or UTF-16?")
    return data


def _check_elements(root: etree._Element, path: Path) -> None:
    # Iterative: the interpreter's own stack must not be the limit.
    stack = [(root, 1)]
    while stack:
        element, depth = stack.pop()
        if depth > MAX_DEPTH:
            raise UrdfError(Place(path, element.sourceline or 0), f"nested deeper than {MAX_DEPTH} elements")
        for name, text in element.attrib.items():
            if found := unprintable(str(text)):
                raise UrdfError(Place(path, element.sourceline or 0), f"<{element.tag} {name}={text!r}> {found[1]}")
        stack.extend((child, depth + 1) for child in element if isinstance(child.tag, str))
