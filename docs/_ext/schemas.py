"""JSON schemas of an arm.toml and of what commands write with --json, made from the readers and from what was written.

`python docs/_ext/schemas.py` writes them into `armflex/schemas/`. A test says where one of them is old.
"""

from __future__ import annotations

import json
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from formats import HERE, header, listening
from keys import KEYS

from armflex import load_arm
from armflex.conventions import UNITS
from armflex.declaration import Declaration
from armflex.files.effect_file import UNNAMED
from armflex.laws.effects import CATALOGUE
from armflex.laws.effects.catalogue import EVERY

SCHEMAS = HERE.parent / "armflex" / "schemas"
GOLDENS = HERE.parent / "tests" / "goldens"
DRAFT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]

OF_THE_ARM = ("joint", "link", "site", "axis", "partner", "depends_on", "seen_from", "to", "at", "tip", "end", "base")
"""Keys whose choices are names of the arm."""


@dataclass
class Asked:
    """How a key was asked for.

    Attributes:
        accessors: Names of the methods of `Declaration`.
        shapes: Of arrays.
        choices: Of words, each time it was asked.
        kind: Of quantity, '' of none.
        needed: Tables, by identity, that could not be read without it.
    """

    accessors: set[str] = field(default_factory=set)
    shapes: set[tuple[int, ...]] = field(default_factory=set)
    choices: set[tuple[str, ...]] = field(default_factory=set)
    kind: str = ""
    needed: set[int] = field(default_factory=set)


OPTIONAL = ("has", "subs", "part", "array_of", "flag", "quantity")
"""Accessors that take a key as absent."""

Tables = dict[str, dict[str, Asked]]
"""Table -> key -> how it was asked for."""

Read = dict[str, dict[int, Any]]
"""Table -> those of that name that were read, by identity."""


def _note(
    tables: Tables,
    read: dict[str, dict[int, Any]],
    table: Declaration,
    name: str,
    key: str,
    given: tuple,
    named: Mapping,
) -> None:
    """Note how a key is asked for, and of which table, by identity."""
    asked = tables.setdefault(header(table), {}).setdefault(key, Asked())
    asked.accessors.add(name)
    asked.shapes |= set(given) if name == "numbers" else set()
    asked.choices |= {tuple(given[0])} if name == "choice" else set()
    asked.kind = given[0] if name == "quantity" else asked.kind
    read.setdefault(header(table), {})[id(table.table)] = table.table
    defaults = {"choice": given[1:2], "text": given, "number": given, "std": given}.get(name, ())
    has_default = any(default is not None for default in (*defaults, named.get("default")))
    if name not in OPTIONAL and not has_default:
        asked.needed.add(id(table.table))


def examples() -> list[Path]:
    """Return the arm files of the pages and of the bundled robots."""
    return sorted([*(HERE / "formats").glob("*.toml"), *HERE.parent.glob("robots/*/arm.toml")])


def presets(path: Path) -> list[str | None]:
    """Return the names of an arm file's presets, and None for the arm without one."""
    return [None, *tomllib.loads(path.read_text(encoding="utf-8")).get("preset", {})]


def arm_schema() -> Schema:
    """Return the schema of an arm.toml: what its readers ask for while they read the examples."""
    tables: Tables = {}
    read: Read = {}
    with warnings.catch_warnings(), listening(partial(_note, tables, read)):
        warnings.simplefilter("ignore")
        for path in examples():
            for preset in presets(path):
                load_arm(path, preset=preset)
    for name, keys in tables.items():
        for key, asked in keys.items():
            everywhere = set(read[name]) <= asked.needed and all(key in table for table in read[name].values())
            if asked.accessors & set(OPTIONAL) or not everywhere:
                asked.needed = set()  # some were read without it
    root = _table("", tables)
    root["properties"]["effect"]["items"]["properties"]["name"] = {"enum": sorted([*CATALOGUE, UNNAMED])}
    return {
        "$schema": DRAFT,
        "$id": "armflex-arm-1",
        "title": "arm.toml",
        "description": "An arm as declared, and as calibrated; see the page of formats.",
        **root,
    }


def _table(name: str, tables: Tables) -> Schema:
    """Return the schema of a table; its keys are names of the user's where the pages say NAME."""
    keys, meanings = tables.get(name, {}), KEYS.get(name, {})
    if name == "preset.NAME":
        flexures = {"type": "object", "additionalProperties": _table("flexure.NAME", tables)}
        return {"type": "object", "properties": {"flexure": flexures}, "additionalProperties": False}
    prefix = f"{name}." if name else ""
    if set(meanings) == {"NAME"} or f"{prefix}NAME" in KEYS or f"{prefix}NAME" in tables:
        if f"{prefix}NAME" in {*KEYS, *tables} and (set(meanings) <= {"NAME"} or not keys):
            return {"type": "object", "additionalProperties": _table(f"{prefix}NAME", tables)}
        shapes = {shape for asked in keys.values() for shape in asked.shapes}
        return {"type": "object", "additionalProperties": _array(shapes) if shapes else True}
    keys = {**{key: Asked() for key in meanings if key != "NAME"}, **keys}
    if not keys:
        return {"type": "object"}
    properties: Schema = {}
    patterns: Schema = {}
    for key, asked in sorted(keys.items()):
        value = _value(f"{prefix}{key}", key, asked, tables)
        if key in meanings and meanings[key].meaning:
            unit = f" [{meanings[key].unit}]" if meanings[key].unit else ""
            value = {"description": meanings[key].meaning + unit, **value}
        properties[key] = value
        if asked.kind:
            units = "|".join(re.escape(unit) for unit in UNITS[asked.kind])
            patterns[f"^{re.escape(key)}_({units})$"] = value
    schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    if patterns:
        schema["patternProperties"] = patterns
    required = [key for key, asked in sorted(keys.items()) if asked.needed]
    return schema | ({"required": required} if required else {})


def _value(name: str, key: str, asked: Asked, tables: Tables) -> Schema:
    accessors = asked.accessors
    if "array_of" in accessors:
        return {"type": "array", "items": _table(name, tables)}
    if accessors & {"sub", "subs", "part"}:
        inner = _table(f"{name}.NAME", tables) if "subs" in accessors else _table(name, tables)
        return {"type": "object", "additionalProperties": inner} if "subs" in accessors else inner
    kinds: list[Schema] = []
    if "text" in accessors or "choice" in accessors:
        fixed = len(asked.choices) == 1 and key not in OF_THE_ARM and "text" not in accessors
        kinds.append({"enum": list(next(iter(asked.choices)))} if fixed else {"type": "string", "minLength": 1})
    if "texts" in accessors:
        kinds.append({"type": "array", "items": {"type": "string"}})
    if "flag" in accessors:
        kinds.append({"type": "boolean"})
    if accessors & {"number", "quantity"}:
        kinds.append({"type": "number"})
    if "std" in accessors:
        kinds.append({"type": "number", "minimum": 0})
    if "numbers" in accessors:
        kinds.append(_array(asked.shapes))
    if "ragged" in accessors:
        kinds.append({"type": "array"})
    return {} if not kinds else kinds[0] if len(kinds) == 1 else {"anyOf": kinds}


def _array(shapes: Iterable[tuple[int, ...]]) -> Schema:
    """Return the schema of nested arrays of numbers of one of some shapes."""
    each = []
    for shape in sorted(shapes):
        schema: Schema = {"type": "number"}
        for size in reversed(shape):
            schema = {"type": "array", "items": schema, "minItems": size, "maxItems": size}
        each.append(schema)
    return each[0] if len(each) == 1 else {"anyOf": each}


ENOUGH = 4
"""Runs of which all have a key, from which on it is always there."""

NAMES = {"A1", "J1", "J2", "p300", "p600", "empty", "p100", "none", "M1"}
"""Of joints, flexures and payloads of the bundled arms: an object that has one as a key is keyed by such names."""


def output_schemas() -> dict[str, Schema]:
    """Return by name the schema of every JSON that a command wrote into `tests/goldens` and that names its format."""
    written: dict[str, list[Any]] = {}
    for path in sorted(GOLDENS.glob("*.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(content, Mapping) and str(content.get("format", "")).startswith("armflex-"):
            written.setdefault(content["format"], []).append(content)
    schemas = {name: {"$schema": DRAFT, "$id": name, **_common(contents)} for name, contents in written.items()}
    for schema in schemas.values():
        schema["properties"]["format"] = {"const": schema["$id"]}
        schema["required"] = sorted({"format", *schema["required"]})
    return schemas


def _common(values: Sequence[Any]) -> Schema:
    """Return the schema that some JSON values have in common, or null in their place: what a run does not know.

    A key is required where it is in all of several runs.
    """
    kinds = {_kind(value) for value in values} - {"null"}
    values = [value for value in values if value is not None]
    if kinds == {"object"}:
        keys = dict.fromkeys(key for value in values for key in value)
        if keys and (keys.keys() <= EVERY.keys() or keys.keys() & NAMES):
            items = [item for value in values for item in value.values()]
            return {"type": ["object", "null"], "additionalProperties": _common(items)}
        required = [key for key in keys if len(values) >= ENOUGH and all(key in value for value in values)]
        properties = {key: _common([value[key] for value in values if key in value]) for key in keys}
        return {"type": ["object", "null"], "properties": properties, "required": required}
    if kinds == {"array"}:
        items = [item for value in values for item in value]
        return {"type": ["array", "null"], "items": _common(items)} if items else {"type": ["array", "null"]}
    if len(kinds) > 1:
        return {"anyOf": [_common([value for value in values if _kind(value) == kind]) for kind in sorted(kinds)]}
    return {"type": [kinds.pop(), "null"]} if kinds else {}


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    names = {bool: "boolean", int: "number", float: "number", str: "string", list: "array", dict: "object"}
    return names[type(value)]


def main() -> None:
    """Write the schemas."""
    schemas = {"armflex-arm-1": arm_schema(), **output_schemas()}
    SCHEMAS.mkdir(exist_ok=True)
    for name, schema in schemas.items():
        (SCHEMAS / f"{name}.json").write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
