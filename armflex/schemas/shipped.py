"""The schemas that come along, with the names of installed plug-ins."""

import json
from pathlib import Path
from typing import Any

from armflex.laws.declared import LAWS
from armflex.laws.effects import CATALOGUE
from armflex.readings import SENSOR_KINDS

ARM = "armflex-arm-1"
"""Of an arm.toml."""

HERE = Path(__file__).parent


def schema_names() -> list[str]:
    """Return the names of all schemas; that of a file of --json is its "format"."""
    return sorted(path.stem for path in HERE.glob("*.json"))


def read_schema(name: str) -> dict[str, Any]:
    """Return a schema; that of an arm.toml has the names of installed plug-ins, too.

    Args:
        name: One of `schema_names`.
    """
    schema = json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))
    if name == ARM:
        tables = schema["anyOf"][1]["properties"]  # where nothing is said to be required
        for table, key, registry in (
            (tables["flexure"]["additionalProperties"], "model", LAWS),
            (tables["instrument"]["additionalProperties"], "kind", SENSOR_KINDS),
            (tables["effect"]["items"], "name", CATALOGUE),
        ):
            choices = table["properties"][key]
            choices["enum"] = list(dict.fromkeys((*choices["enum"], *registry.names())))
    return schema
