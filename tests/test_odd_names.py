"""Names are text: an arm and its campaign whose every name would be markup, a formula or a script to somebody."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from xml.sax.saxutils import quoteattr

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result
from small_arms import joint, link, robot

from armflex import Arm, InputError, Measurements, Reading, Tracker, load_arm, predict, read_measurements, train
from armflex.calibrate import calibrate
from armflex.cli import options, tables
from armflex.cli.main import Commands
from armflex.measured.joint_data import read_joint_data
from armflex.printable import printable
from armflex.view.laws import draw_laws

MARKUP, FORMULA, SCRIPT, BOLD, DATA = "[/x]", r"$\frac{$", "<script>alert(1)</script>", "[bold", '"]</script>{{7*7}}'
ODD = (MARKUP, FORMULA, SCRIPT, BOLD, DATA)
JOINTS = (MARKUP, FORMULA, SCRIPT)
LINKS = (DATA, FORMULA, BOLD, SCRIPT, MARKUP)
PAYLOADS = {SCRIPT: 5.0, MARKUP: 40.0, FORMULA: 80.0}
POSES = 14
SIGMA = 5e-5
SESSIONS, COLUMN, REMARK = (MARKUP, SCRIPT), f"{FORMULA} temperature", BOLD
CODES = ("\x1b[31m", "\x9b2J", "\u202e", "\u2066", "\x07", "\u2028", "\x7f")
"""What would colour or clear a terminal, or turn the order of letters about."""


def quoted(text: str) -> str:
    return json.dumps(text)  # a TOML text, too


def urdf(joints: tuple[str, ...] = JOINTS) -> str:
    """Return three joints, 1.7 m long, every name odd."""
    base, column, upper, fore, tool = (quoteattr(name)[1:-1].replace('"', "&quot;") for name in LINKS)
    yaw, pitch, bend = (quoteattr(name)[1:-1].replace('"', "&quot;") for name in joints)
    return robot(
        link(base),
        joint(yaw, base, column, (0, 0, 0.4), axis=(0, 0, 1)),
        link(column, 40.0, (0.05, 0, 0.1)),
        joint(pitch, column, upper, (0.1, 0, 0.2)),
        link(upper, 30.0, (0.4, 0.02, 0)),
        joint(bend, upper, fore, (0.8, 0.05, 0)),
        link(fore, 20.0, (0.3, 0, 0.02)),
        joint("flange", fore, tool, (0.6, 0, 0), kind="fixed"),
        link(tool),
    )


def declared(effect: str = "", learn: str = "") -> str:
    """Return arm.toml of that robot, with what a campaign may find."""
    lines = ["[robot]", 'urdf = "arm.urdf"', f"tip = {quoted(LINKS[-1])}", f"base = {quoted(LINKS[0])}"]
    for name, mass in PAYLOADS.items():
        lines += [f"[payload.{quoted(name)}]", f"mass = {mass}", "com = [0.05, 0, 0]"]
    for name in JOINTS:
        lines += [f"[flexure.{quoted(name)}]", f"joint = {quoted(name)}", 'model = "linear"', learn]
        lines += ["compliance = [1e-8, 1e-8, 1e-8, 2e-6, 2e-6, 2e-6]"]
    lines += ["[measurement]", 'frame = "base"', "[prior]", "joint_offset = 1e-3", "compliance = 0.2", effect]
    return "\n".join(lines) + "\n"


GROWN = f"""[[effect]]
name = "thermal_growth"
site = {quoted(SCRIPT)}
parameters = {{ alpha = 5e-5, reference = 0.0 }}
covariates = [{quoted(COLUMN)}]
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the arm, a trajectory, a campaign of an arm that is softer and grows with a column, and a joint's table."""
    folder = tmp_path_factory.mktemp("field")
    (folder / "arm.urdf").write_text(urdf())
    (folder / "arm.toml").write_text(declared())
    (folder / "true.toml").write_text(declared(effect=GROWN))
    rng = np.random.default_rng(3)
    rows = rng.uniform(-1.2, 1.2, (POSES, 3)).repeat(3, axis=0)
    table = {
        "pose": [f"{ODD[i % 5]} {i}" for i in range(POSES) for _ in PAYLOADS],
        "session": [SESSIONS[i % 2] for i in range(len(rows))],
        "payload": list(PAYLOADS) * POSES,
        **{f"q_{name}": rows[:, i].tolist() for i, name in enumerate(JOINTS)},
        COLUMN: rng.uniform(-10.0, 10.0, len(rows)).tolist(),
        REMARK: [ODD[i % 2] for i in rng.integers(0, 2, len(rows))],
    }
    write_csv(folder / "rows.csv", table)
    true = load_arm(folder / "true.toml")
    position = predict(true, read_measurements(folder / "rows.csv", true, inputs_only=True)).position
    position += rng.normal(0.0, SIGMA, position.shape)
    measured = {axis: position[:, i].tolist() for i, axis in enumerate("xyz")}
    write_csv(folder / "campaign.csv", {**table, **measured, "sigma": [SIGMA] * len(rows)})
    path = {f"q_{name}": [0.1 * i, 0.3, -0.2 * i] for i, name in enumerate(JOINTS)}
    write_csv(
        folder / "path.csv",
        {"time": [0.0, 1.0, 2.0], **path, "payload": list(PAYLOADS), "via": [MARKUP, FORMULA, SCRIPT]},
    )
    loads = rng.normal(size=(30, 6)) * [1e3, 1e3, 1e3, 500.0, 500.0, 500.0]
    names = ("fx", "fy", "fz", "mx", "my", "mz", "dx", "dy", "dz", "rx", "ry", "rz")
    units = ("N",) * 3 + ("Nm",) * 3 + ("mm",) * 3 + ("mrad",) * 3
    both = np.hstack([loads, loads * [1e-5, 1e-5, 1e-5, 2e-3, 2e-3, 2e-3] + rng.normal(0.0, 1e-4, loads.shape)])
    write_csv(
        folder / "joint.csv",
        {f"{name}_{unit}": both[:, i].tolist() for i, (name, unit) in enumerate(zip(names, units, strict=True))},
    )
    return folder


def write_csv(path: Path, columns: dict[str, list]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def run(name: str, *arguments: object) -> Result:
    """Run a command in this process, which is quicker than one of its own."""
    options._said.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return CliRunner().invoke(Commands().get_command(None, name), list(map(str, arguments)))


def done(name: str, *arguments: object, code: int = 0) -> str:
    result = run(name, *arguments)
    assert result.exit_code == code or result.return_value == code, result.output
    assert not result.exception or isinstance(result.exception, SystemExit), result.exception
    return result.output


class Page(HTMLParser):
    """What a browser makes of a page: its elements by name, and its text outside of scripts."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[str] = []
        self.text = ""
        self.data: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list) -> None:
        self.elements.append(tag)
        assert not any(name.startswith("on") for name, _ in attributes)
        self.data += [] if tag != "script" else [""]

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            self.data[-1] += data
        else:
            self.text += data


def whole(picture: Path) -> bool:
    return picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 20_000


def test_deflect(field: Path, tmp_path: Path) -> None:
    q = f"{FORMULA}=0.3,{SCRIPT}=10deg"
    said = done("deflect", field / "arm.toml", "--q", q, "--payload", MARKUP, "--force", f"{MARKUP}=0,0,-10N")
    assert all(name in said for name in (*JOINTS, LINKS[0], MARKUP))
