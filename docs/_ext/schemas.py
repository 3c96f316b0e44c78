"""JSON schemas of an arm.toml and of what commands write with --json, made from the readers and from what was written.

`python docs/_ext/schemas.py` runs the pages and more for that, some minutes long, and writes them into
`armflex/schemas/`. Whatever a test has a command write is held against them.
"""

from __future__ import annotations

import contextlib
import json
import re
import shlex
import shutil
import sys
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from subprocess import CompletedProcess
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from formats import HERE, header, listening
from keys import KEYS

from armflex import load_arm
from armflex.cli import options
from armflex.conventions import UNITS
from armflex.declaration import Declaration
from armflex.files.effect_file import UNNAMED
from armflex.laws.effects import CATALOGUE
from armflex.laws.effects.catalogue import EVERY
from armflex.result import plain
from armflex.version import __version__

sys.path.append(str(HERE.parent / "tests"))
from goldens import GOLDENS
from support.command_line import run_here
from support.page_blocks import APART, PAGES, blocks, run_page
from support.small_arms import ROBOTS

SCHEMAS = HERE.parent / "armflex" / "schemas"
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


PLUGGED = {"flexure.NAME": "model", "flexure.NAME.subjoint": "model", "instrument.NAME": "kind"}
"""Table -> key that may name what a plug-in brings, whose further keys are its own."""

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
    tables_of = root["properties"]
    flexure, instrument = (tables_of[name]["additionalProperties"]["anyOf"][0] for name in ("flexure", "instrument"))
    known = {
        "effect": {"items": _named("name", sorted([*CATALOGUE, UNNAMED]))},
        "flexure": {"additionalProperties": _named("model", flexure["properties"]["model"]["enum"])},
        "instrument": {"additionalProperties": _named("kind", instrument["properties"]["kind"]["enum"])},
    }
    # Whoever needs a plug-in says so; its names and keys are then its own.
    root["anyOf"] = [{"required": ["requires"]}, {"properties": known}]
    return {
        "$schema": DRAFT,
        "$id": "armflex-arm-1",
        "title": "arm.toml",
        "description": "An arm as declared, and as calibrated; see the page of formats.",
        **root,
    }


def _named(key: str, names: Sequence[str]) -> Schema:
    """Return the schema of tables in which a key is one of some names."""
    return {"properties": {key: {"enum": list(names)}}}


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
    schema |= {"required": required} if required else {}
    if (kind := PLUGGED.get(name)) is None:
        return schema
    other = {"type": "string", "not": {"enum": properties[kind]["enum"]}}
    return {"anyOf": [schema, {"type": "object", "properties": {kind: other}, "required": [kind]}]}


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

RUNS = """
deflect robots/tarm_like/measured.toml --payload p300 --force fz=-500N
deflect robots/palletizer/arm.toml
deflect robots/hybrid_lifter/arm.toml --payload t125
modes robots/tarm_like/arm.toml
modes robots/palletizer/arm.toml
check robots/hybrid_lifter/arm.toml robots/hybrid_lifter/trajectory.csv --tolerance 1mm
compensate robots/hybrid_lifter/arm.toml robots/hybrid_lifter/trajectory.csv -o lifter.csv
compensate robots/palletizer/arm.toml robots/palletizer/trajectory.csv -o palletizer.csv
calibrate robots/tarm_like/measured.toml part_0.csv -o arm_0.toml
calibrate robots/tarm_like/measured.toml part_1.csv -o arm_1.toml
calibrate robots/tarm_like/measured.toml part_2.csv -o arm_2.toml
deflect arm_0.toml --payload p300
check arm_0.toml robots/tarm_like/trajectory.csv --tolerance 50mm
history arm_0.toml arm_1.toml arm_2.toml
prior arm_0.toml arm_1.toml arm_2.toml -o next.toml
report arm_0.toml robots/tarm_like/campaign.csv --iso9283 --block 10min
trace robots/tarm_like/measured.toml part_0.csv -o traced.toml --halves 1
export traced.toml --to sheet
export robots/palletizer/arm.toml --to urdf -o palletizer.urdf
export robots/tarm_like/learned.toml --to c -o boom.c
plan robots/tarm_like/measured.toml --rows 4 -o poses.csv
rehearse robots/heavy_six/arm.toml --draws 1
map robots/heavy_six/arm.toml --rows 512 --voxel 0.5m --frequency --draws 2 -o heavy.csv
map robots/palletizer/arm.toml --rows 512 --tolerance 1mm -o palletizer.csv
train robots/tarm_like/a4_table_1.csv --model bayesian -o law.safetensors
train robots/tarm_like/a4_table_1.csv --model auto -o law.safetensors
train turns.csv --model linear -o law.safetensors
view robots/palletizer/arm.toml -o palletizer.html
demo -o demo
"""
"""What neither the pages nor the goldens run, in order in one folder, in which `robots` are the bundled ones."""

PARTS = 3
"""Campaigns that the boom's is parted into: `part_0.csv` and so on."""

TURNS = "fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,dx_m,dy_m,dz_m,rx_rad,ry_rad,rz_rad"
"""Columns of `turns.csv`, a bench table of shifts and rotations."""


def written() -> list[Any]:
    """Return what the goldens have, and what the commands of the pages and of `RUNS` write, for programs."""
    outputs = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(GOLDENS.glob("*.json"))]
    outputs = [{**content, "armflex": __version__} for content in outputs if "format" in content]
    write = options.write_json

    def keep(content: dict[str, Any], path: Path | None = None) -> None:
        write(content, path)
        outputs.append(plain({**content, "armflex": __version__}))

    def run(*arguments: object) -> CompletedProcess[str]:
        words = [str(word) for word in arguments]
        asked = {"--help", "--json"} & {*words} or words[0] == "schema"
        return run_here(Path(), *words, *([] if asked else ["--json", "out.json"]))

    with patch.object(options, "write_json", keep):
        for page in PAGES:
            if page.name not in APART and any(block.language == "console" for block in blocks(page)):
                with TemporaryDirectory() as folder, contextlib.chdir(folder):
                    run_page(page, run)
        with TemporaryDirectory() as folder, contextlib.chdir(folder):
            for path in (ROBOTS / "heavy_six").iterdir():
                shutil.copy(path, folder)
            lines = [words for block in blocks(HERE / "export.md") for words in block.commands]
            Path("robots").symlink_to(ROBOTS, target_is_directory=True)
            head, *rows = Path("robots/tarm_like/campaign.csv").read_text(encoding="utf-8").splitlines()
            for part in range(PARTS):
                Path(f"part_{part}.csv").write_text("\n".join([head, *rows[part::PARTS]]), encoding="utf-8")
            loads = np.random.default_rng(0).normal(size=(30, 6))
            bent = np.hstack([1e3 * loads, 1e-3 * loads + 1e-5 * loads[::-1]])
            np.savetxt("turns.csv", bent, delimiter=",", header=TURNS, comments="")
            lines += [shlex.split(line) for line in RUNS.strip().splitlines()]
            for words in lines:
                done = run(*words[words[0] == "armflex" :])
                assert done.returncode < 2, done.stderr
    return outputs


def output_schemas(contents: Iterable[Any]) -> dict[str, Schema]:
    """Return by name the schema of outputs that name their format."""
    of_format: dict[str, list[Any]] = {}
    for content in contents:
        of_format.setdefault(content["format"], []).append(content)
    schemas = {name: {"$schema": DRAFT, "$id": name, **_common(some)} for name, some in sorted(of_format.items())}
    for schema in schemas.values():
        schema["type"] = "object"
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
        items = [item for value in values for item in value.values()]
        if keys and (keys.keys() <= EVERY.keys() or _are_names(values)):
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


def _are_names(values: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether the keys of objects are names of the user's: two of them have none in common."""
    return not set.intersection(*({*value} for value in values if value))


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    names = {bool: "boolean", int: "number", float: "number", str: "string", list: "array", dict: "object"}
    return names[type(value)]


def main() -> None:
    """Write the schemas."""
    schemas = {"armflex-arm-1": arm_schema(), **output_schemas(written())}
    SCHEMAS.mkdir(exist_ok=True)
    for name, schema in schemas.items():
        (SCHEMAS / f"{name}.json").write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
