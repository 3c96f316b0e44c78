"""The arm as other programs read it: each format is a module with a function `export(arm, **options) -> Exported`.

A format refuses by name what it cannot carry, or says in `Exported.notes` what that amounts to.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from armflex.errors import Flag, did_you_mean, listing

OPTIONS = ("over", "traj", "name", "axes", "flavour", "compensate", "slower", "covariates", "unnamed")
"""Options of `armflex export` that an exporter of a plug-in may have as parameters."""


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


def exporter_fault(export: object) -> str:
    """Return what an exporter should have been, '' where it is a function of an arm and of some of `OPTIONS`."""
    expected = "expected a function export(arm, OPTION, ..) -> Exported"
    if not callable(export):
        return expected
    parameters = list(inspect.signature(export).parameters.values())
    if not parameters or any(one.kind in (one.VAR_KEYWORD, one.VAR_POSITIONAL) for one in parameters):
        return expected
    for name in (parameter.name for parameter in parameters[1:]):
        if name not in OPTIONS:
            return f"{name!r} is no option of `armflex export`{did_you_mean(name, OPTIONS)} (known: {listing(OPTIONS)})"
    return ""
