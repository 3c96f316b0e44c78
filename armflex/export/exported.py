"""What an exporter returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Exported:
    """The arm as another program reads it.

    Attributes:
        text: The whole file.
        told: Lines for who exports, such as what the format cannot carry, in mm.
        numbers: The same for programs: what `--json` gets beside the format's name, SI.
        page: What a screen shows instead of the file, '' where that is the file.
    """

    text: str
    told: tuple[str, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    page: str = ""
