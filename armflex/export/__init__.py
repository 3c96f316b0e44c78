"""The arm as other programs read it: each format is a module with a function `export(arm, **options) -> Exported`.

A format refuses by name what it cannot carry, or says in `Exported.notes` what that amounts to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from armflex.errors import Flag


@dataclass(frozen=True)
class Exported:
    """The arm as another program reads it.

    Attributes:
        text: The whole file.
        notes: Lines for who exports, such as what the format cannot carry, in mm.
        numbers: The same for programs: what `--json` gets beside the format's name, SI.
        flags: What is doubtful about it.
        page: What a screen shows instead of the file, '' where that is the file.
    """

    text: str
    notes: tuple[str, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    flags: tuple[Flag, ...] = ()
    page: str = ""
