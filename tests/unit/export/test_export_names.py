"""Names of any kind in every export come back or have a safe form; none of them runs, ends or adds anything."""

import csv
import dataclasses
import io
import json
import re
import subprocess
import tempfile
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.compiled_arm import COMPILER
from support.exported import krl_moves, ls_moves, rapid_moves, urscript_moves, val3_moves
from support.small_arms import arm_of, joint, link

from armflex import Arm, Payload
from armflex.export import c_code, programs, quoting, shaper, sheet, urdf_file
from armflex.show.view.meshcat_page import render_page
from armflex.show.view.scene_3d import Scene

PIECES = (
    *("*/", "/*", "//", "\\", "??/", "?", "\n", "\r\n", '"', "'", "#error ran\n", "/*@constants*/", "NAME_tip", "NAME"),
    *(
        "\nhalt()\n",
        ";",
        "!",
        "\nEND\n",
        "]]>",
        "<!--",
        "</script><script>ran()",
        "&amp;",
        "<b>",
        "\n- ran: 1",
        "{ran}",
    ),
    *("=cmd|' /C calc'!A0", "+1", "@SUM(1)", ",", "\t", "%s", "é", "中", "\U0001f600", "a", " "),
)
"""Ends of comments, strings and elements of one language or another, and what would follow."""

SHOWN = st.lists(st.sampled_from(PIECES), min_size=1, max_size=5).map("".join)
"""Names that files may hold."""

ANY = st.one_of(
    SHOWN, st.text(min_size=1, max_size=12), st.sampled_from(("\0", "\u2028*/", "\x1b[2J", "\x85", "\ud800"))
)
"""Names that a program may give, of characters that no file may hold, too."""

Q = np.array([[0.1, 0.2, -0.3, 0.4, 0.5, -0.6], [0.5, -0.1, 0.2, 0.3, -0.4, 0.1], [0.5, -0.1, 0.2, 0.3, -0.4, 0.1]])


def arm_named(folder: Path, names: list[str], payload: str) -> Arm:
    """Return an arm of six joints, each with its link, flexure and name, and a payload."""
    parts = [link("l0", 1.0)]
    ends = ["l0", *(f"link {name}" for name in names)]
    attribute = [quoteattr(name, {'"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})[1:-1] for name in ends]
    moving = [quoteattr(name, {'"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})[1:-1] for name in names]
    for i, name in enumerate(moving):
        parts += [joint(name, attribute[i], attribute[i + 1], (0.1, 0, 0.3)), link(attribute[i + 1], 1.0)]
    arm = arm_of(folder, parts, ends[-1], {names[0]: np.diag([0, 0, 0, 0, 1e-5, 0.0])})
    return dataclasses.replace(arm, payloads={payload: Payload(1.0, np.zeros(3))})


def path_named(folder: Path, arm: Arm, via: str) -> Path:
    """Return a trajectory of three rows at rest, one of which has a name."""
    file, text = folder / "path.csv", io.StringIO(newline="")
    rows = csv.writer(text, quoting=csv.QUOTE_ALL)
    rows.writerow(["time", *(f"q_{name}" for name in arm.joint_names), "via"])
    rows.writerows([i, *q, via if i == 1 else ""] for i, q in enumerate(Q.tolist()))
    file.write_bytes(text.getvalue().encode())
    return file


def c_names(folder: Path, text: str, array: str) -> list[str]:
    """Return the names in an array of an exported arm as a compiler has them."""
    (folder / "arm.c").write_text(text, encoding="utf-8", newline="")
    show = (
        f"#include <stdio.h>\nextern const char *const {array}[];\nint main(void) {{ const char *const *one = {array};"
    )
    show += ' for (; *one; one++) { printf("%s%c", *one, 0); } return 0; }\n'
    (folder / "show.c").write_text(show)
    files = [folder / "arm.c", folder / "show.c", "-o", folder / "show"]
    made = subprocess.run(
        [str(COMPILER), "-std=c99", "-O0", *files, "-lm"], capture_output=True, text=True, timeout=300
    )
    assert made.returncode == 0, made.stderr
    return (
        subprocess.run([folder / "show"], capture_output=True, check=True, timeout=600).stdout.decode().split("\0")[:-1]
    )


@pytest.mark.parametrize("language", ["urscript", "krl", "rapid", "ls", "val3"])
@given(names=st.lists(SHOWN, min_size=6, max_size=6, unique_by=lambda one: one.strip()), via=SHOWN)
@settings(max_examples=4, deadline=None)
def test_a_program_has_the_moves_and_nothing_else(language: str, names: list[str], via: str) -> None:
    names = [f"{i}{name}." for i, name in enumerate(names)]
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_named(Path(folder), names, "p")
        plain = arm_named(Path(folder), list("abcdef"), "p")
        wrote, expected = (
            getattr(programs, language)(one, path_named(Path(folder), one, name)).text
            for one, name in ((arm, f"v{via}"), (plain, "v"))
        )
    assert wrote.isascii() and "\r" not in wrote
    moves = {"urscript": urscript_moves, "krl": krl_moves, "rapid": rapid_moves, "ls": ls_moves, "val3": val3_moves}
    assert moves[language](wrote) == moves[language](expected)
    if language == "val3":
        ElementTree.fromstring(wrote)
    mark = {"urscript": "#", "krl": ";", "rapid": "!", "ls": "!", "val3": "//"}[language]

    def code(text: str) -> list[str]:
        lines = [re.sub(r"^ *\d+:", ":", line).partition(mark)[0].rstrip() for line in text.splitlines()]
        return [line for line in lines if line and line != ":"]

    assert code(wrote) == code(expected)


@given(names=st.lists(SHOWN, min_size=6, max_size=6, unique_by=lambda one: one.strip()), via=SHOWN, payload=ANY)
@settings(max_examples=6, deadline=None)
def test_names_come_back_from_what_keeps_them(names: list[str], via: str, payload: str) -> None:
    yaml = pytest.importorskip("yaml")
    names = [f"{i}{name}." for i, name in enumerate(names)]
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_named(Path(folder), names, payload)
        path = path_named(Path(folder), arm, f"v{via}")
        message = yaml.safe_load(programs.jointtrajectory(arm, path).text)
        table = list(csv.reader(io.StringIO(sheet.export(arm).text, newline="")))
        root = ElementTree.fromstring(urdf_file.export(arm).text)
    assert message["joint_names"] == list(arm.joint_names) and len(message["points"]) == len(Q)
    offsets = [row[1] for row in table if row[0] == "joint_offset"]
    assert [name.lstrip("'") for name in offsets] == [name.lstrip("'") for name in arm.joint_names]
    assert not any(cell[:1] in ("=", "+", "@") for row in table for cell in row if not re.fullmatch(r"[+\d.e-]+", cell))
    assert [one.get("name") for one in root.findall("joint")] == list(arm.joint_names)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
@given(names=st.lists(SHOWN, min_size=6, max_size=6, unique_by=lambda one: one.strip()), via=SHOWN, payload=ANY)
@settings(max_examples=3, deadline=None)
def test_c_has_its_names_and_compiles(names: list[str], via: str, payload: str) -> None:
    names = [f"{i}{name}." for i, name in enumerate(names)]
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_named(Path(folder), names, payload)
        shaped = shaper.export(arm, path_named(Path(folder), arm, f"v{via}")).text
        text = c_code.export(arm).text
        assert c_names(Path(folder), text, "arm_joints") == list(arm.joint_names)
        safe = payload.replace("\0", "?").encode("utf-8", "backslashreplace").decode()
        assert c_names(Path(folder), text, "arm_payloads")[-1] == safe
        (Path(folder) / "s.c").write_text(shaped)
        strict = [COMPILER, "-std=c99", "-Wall", "-Werror", "-fsyntax-only", "s.c"]
        subprocess.run(list(map(str, strict)), cwd=folder, check=True, timeout=300)


def test_code_in_the_name_of_a_via_point_stays_a_comment(tmp_path: Path) -> None:
    arm = arm_named(tmp_path, list("abcdef"), "p")
    file = path_named(tmp_path, arm, "a*/\nint ran;\n/*")
    text = shaper.export(arm, file).text
    assert "int ran" not in re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL) and "int ran" in text


@given(ANY)
@settings(max_examples=120, deadline=None)
def test_no_text_ends_a_comment_of_c(name: str) -> None:
    text = quoting.c_comment(name)
    assert text.isascii() and text.isprintable() and "??" not in text and "\\" not in text
    assert not any(mark in f" {text} " for mark in ("*/", "/*", "//"))


@given(ANY)
@settings(max_examples=120, deadline=None)
def test_texts_of_pages_are_texts(name: str) -> None:
    page = ElementTree.fromstring(f'<p title="{quoting.html_text(name)}">{quoting.html_text(name)}</p>')
    assert page.text == page.get("title") and len(page) == 0
    data = quoting.html_data([name])
    assert "<" not in data and data.isascii() and json.loads(data) == [name]


def test_a_page_has_no_script_of_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "</script><script>ran()</script><!--"
    page = render_page(Scene(title=name, subtitle=name, notes=(name,), nodes=[]))
    assert "<script>ran()" not in page
