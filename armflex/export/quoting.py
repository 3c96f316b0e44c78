"""Names of a user's files as texts of other languages: none ends a comment, a string or an element, and none runs.

Every exporter and every page passes its names through here; tables do so in `measured.table.csv_text`, XML in lxml.
"""

import html
import json
import re

from armflex.conventions import printable

_C_COMMENT = (("\\", "/"), ("*/", "* /"), ("/*", "/ *"), ("//", "/ /"))
"""What in C ends a comment, begins one or joins a line to the next, and what stands in its place."""


def c_comment(text: str) -> str:
    """Return a text for a comment of C on one line: ASCII, nothing that ends a comment and no trigraph."""
    plain = "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text)
    for ends, harmless in _C_COMMENT:
        while ends in plain:
            plain = plain.replace(ends, harmless)
    return re.sub(r"\?(?=\?)", "? ", plain)


def c_string(text: str) -> str:
    """Return a string of C with its quotes, which is the text in UTF-8 byte by byte; NUL would end it and is `?`."""
    plain = {*range(32, 127)} - {*b'"\\?'}
    content = text.replace("\0", "?").encode("utf-8", "backslashreplace")
    return '"' + "".join(chr(byte) if byte in plain else f"\\{byte:03o}" for byte in content) + '"'


def line_comment(text: str) -> str:
    """Return a text for the rest of a line in URScript, KRL, RAPID, TP, VAL3 and YAML: ASCII, and no end of CDATA."""
    return printable(text).encode("ascii", "backslashreplace").decode().replace("]]>", "]] >")


def yaml_string(text: str) -> str:
    """Return a string of YAML and of JSON with its quotes, which is read back as the text."""
    letters = json.dumps(text, ensure_ascii=False)
    return "".join(letter if printable(letter) == letter else f"\\u{ord(letter):04x}" for letter in letters)


def html_text(text: str) -> str:
    """Return a text for an element or an attribute of HTML."""
    return html.escape(printable(text))


def html_script(text: str) -> str:
    """Return a program that comes along for a script element, which `</script` ends wherever it stands."""
    return re.sub("</(?=script)", r"<\\/", text, flags=re.IGNORECASE)


def html_data(content: object) -> str:
    """Return numbers and texts as JSON for a script element."""
    return json.dumps(content).replace("<", "\\u003c")
