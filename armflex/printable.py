"""Text that may have come from anywhere, on its way to people: what no terminal, page or picture should be sent."""

from __future__ import annotations

import re

_BREAKS = "\t\n\r"
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
"""Control characters (C0, C1, delete), line and paragraph separators, what turns the order of letters about
(Unicode's embeddings, overrides and isolates), halves of letters (a file name that is no UTF-8), and no letters."""


def printable(text: str, keep: str = "") -> str:
    """Return a text with its unprintable characters shown as Python writes them, `\\x1b`, but for those in `keep`.

    A terminal would obey them: colours, a moved cursor, a title of the window, lines that nobody wrote.
    """
    return _UNPRINTABLE.sub(lambda found: found[0] if found[0] in keep else _shown(found[0]), text)


def unprintable(text: str) -> tuple[int, str] | None:
    """Return where the first character is for which no file's text has a use, and what is wrong with it.

    Tabs and line breaks have a use: in a remark.
    """
    found = next((found for found in _UNPRINTABLE.finditer(text) if found[0] not in _BREAKS), None)
    if found is None:
        return None
    return found.start(), f"holds the character {_shown(found[0])}, which cannot be shown: expected letters"


def _shown(letter: str) -> str:
    return letter.encode("unicode_escape").decode()
