"""The schemas say what the readers say: of the examples, of spoilt files, and of what commands write."""

import copy
import json
import random
import sys
import tomllib
import warnings
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from goldens import GOLDENS
from support.command_line import Run, fine
from support.small_arms import ROBOTS

from armflex import load_arm
from armflex.cli.main import COMMANDS
from armflex.errors import InputError
from armflex.schemas import ARM, HERE, read_schema, schema_names
from armflex.version import __version__

jsonschema = pytest.importorskip("jsonschema")
sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "_ext"))
schemas = pytest.importorskip("schemas")

SPOILT = 500


def test_the_shipped_schema_of_an_arm_is_that_of_the_readers() -> None:
    """`python docs/_ext/schemas.py` writes it anew, and the others; what tests write is held against them all."""
    assert json.loads((HERE / f"{ARM}.json").read_text(encoding="utf-8")) == json.loads(
        json.dumps(schemas.arm_schema())
    )


def test_every_command_with_a_result_for_programs_has_a_schema() -> None:
    for name in COMMANDS:
        command = import_module(f"armflex.cli.{name}_command").command
        if any("--json" in parameter.opts for parameter in command.params) and name != "demo":
            assert f"armflex-{name}-1" in schema_names(), name


@pytest.mark.parametrize("path", sorted(GOLDENS.glob("*.json")), ids=lambda path: path.stem)
def test_a_golden_is_as_its_schema_says(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    if str(content.get("format", "")).startswith("armflex-"):
        jsonschema.validate({**content, "armflex": __version__}, read_schema(content["format"]))


def test_names_and_keys_of_a_plug_in_are_its_own() -> None:
    """Where [requires] says that there is one; what armflex has keeps its keys."""
    sensor = {"kind": "wall_distance", "link": "tool", "sigma": 2e-5, "wall": [1.0, 0.0]}
    bent = {"joint": "J2", "model": "contact", "compliance": [1e-8] * 6, "energy": 0.5}
    lag = {"name": "following_error", "site": "J3", "parameters": {"lag": 1e-3}}
    own = {"instrument": {"laser": sensor}, "flexure": {"J2": bent}, "effect": [lag]}
    arm = tomllib.loads((ROBOTS / "heavy_six" / "arm.toml").read_text(encoding="utf-8"))
    valid = jsonschema.Draft202012Validator(read_schema(ARM)).is_valid
    assert valid(arm)
    for key, tables in own.items():
        assert valid({**arm, "requires": {"extras": ">=0.1"}, key: tables})
        assert not valid({**arm, key: tables})
    needs = {**arm, "requires": {"extras": ">=0.1"}}
    assert not valid(needs | {"instrument": {"laser": {"kind": "distance", "link": "tool", "sigmaa": 2e-5}}})
    assert not valid(needs | {"flexure": {"J2": {"joint": "J2", "model": "linear", "complianc": [1e-8] * 6}}})
    assert not valid(needs | {"flexure": {"J2": {"joint": "J2", "complianc": [1e-8] * 6}}})
    assert not valid(needs | {"effect": [{**lag, "sit": "J3"}]})


@pytest.mark.parametrize("path", schemas.examples(), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_an_example_is_as_the_schema_says(path: Path) -> None:
    jsonschema.validate(tomllib.loads(path.read_text(encoding="utf-8")), read_schema(ARM))


def places(value: Any, way: tuple = ()) -> Iterator[tuple]:
    """Yield the way to every value of a file."""
    if way:
        yield way
    for key, part in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(part, (*way, key))


def spoil(document: dict, rng: random.Random) -> dict | None:
    """Return a file with one mistake, None where the mistake is none there."""
    spoilt = copy.deepcopy(document)
    *outer, key = rng.choice([way for way in places(document) if way[0] != "preset"])
    table = spoilt
    for part in outer:
        table = table[part]
    value, kind = table[key], rng.choice(("drop", "rename", "text", "negative", "nested", "number", "flag", "short"))
    if kind == "drop":
        del table[key]
    elif kind == "rename" and isinstance(table, dict):
        table[f"{key}x"] = table.pop(key)
    elif kind == "negative" and isinstance(value, int | float) and not isinstance(value, bool):
        table[key] = -abs(value) - 1.0
    elif kind == "short" and isinstance(value, list) and value:
        value.pop()
    elif kind in ("text", "nested", "number", "flag"):
        table[key] = {"text": "nonsense", "nested": [value], "number": 7.5, "flag": True}[kind]
    else:
        return None
    return spoilt


@pytest.mark.slow
def test_most_spoilt_files_are_refused_by_the_schema_and_no_good_one_is(tmp_path: Path) -> None:
    rng, validator = random.Random(20), jsonschema.Draft202012Validator(read_schema(ARM))
    paths = [path for path in schemas.examples() if path.name != "arm.toml"] + [ROBOTS / "heavy_six" / "arm.toml"]
    documents = [(path, tomllib.loads(path.read_text(encoding="utf-8"))) for path in paths]
    refused = caught = count = 0
    while count < SPOILT:
        path, document = rng.choice(documents)
        if (spoilt := spoil(document, rng)) is None:
            continue
        count += 1
        robot, urdf = spoilt.get("robot"), document["robot"].get("urdf")
        if isinstance(robot, dict) and urdf and robot.get("urdf") == urdf:
            robot["urdf"] = str((path.parent / urdf).resolve())
        (tmp_path / "arm.toml").write_text(tomlkit.dumps(spoilt))
        valid = validator.is_valid(spoilt)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                load_arm(tmp_path / "arm.toml")
        except InputError:
            refused += 1
            caught += not valid
        else:
            assert valid, (path, [error.message for error in validator.iter_errors(spoilt)])
    assert refused > SPOILT / 2 and caught >= refused / 2, (refused, caught)


def test_an_output_names_its_schema_and_the_version(armflex: Run, tmp_path: Path) -> None:
    arm = ROBOTS / "palletizer" / "arm.toml"
    fine(armflex("deflect", arm, "--json", "d.json"))
    written = json.loads((tmp_path / "d.json").read_text())
    printed = json.loads(fine(armflex("schema", written["format"])).stdout)
    jsonschema.validate(written, printed)
    assert written["armflex"] == __version__
    assert fine(armflex("schema")).stdout.split() == schema_names()
    assert "no schema named 'trave', did you mean 'trace'?" in fine(armflex("schema", "trave"), 2).stderr
