"""What the pages say works: every code block runs, and every key and column that a reader asks for has a meaning.

A page's blocks run in order in one folder, in which `robots` are the bundled ones. A comment before a block says what
is special about it: `<!-- file: NAME -->` it is that file, `<!-- exit 1 -->` its commands end so, `<!-- slow: WHY -->`
it takes its time, `<!-- not run: WHY -->`.
"""

import re
import shlex
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from support.command_line import run_here
from support.small_arms import ROBOTS

import armflex

ROOT = ROBOTS.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
APART = {"export.md": "tests/unit/export/test_export_docs.py", "c-export.md": "examples/13_c_in_the_controller.py"}
"""Pages whose commands are run elsewhere."""

BLOCK = re.compile(r"((?:<!--[^\n]*-->\n)*)^```(\w+|\{[\w-]+\})[^\n]*\n(.*?)^```", re.M | re.S)
RUN = ("python", "console", "toml")


class Block(NamedTuple):
    """A block of code: its language, its text, and what the comments before it say."""

    language: str
    text: str
    said: str

    def has(self, word: str) -> bool:
        return f"<!-- {word}" in self.said

    @property
    def file(self) -> str:
        found = re.search(r"<!-- file: (\S+) -->", self.said)
        return found[1] if found else ""


def blocks(page: Path) -> list[Block]:
    found = [Block(language, text, said) for said, language, text in BLOCK.findall(page.read_text())]
    return [one for one in found if (one.language in RUN or one.file) and not one.has("not run")]


def cases() -> list:
    found = []
    for page in PAGES:
        some = [] if page.name in APART else blocks(page)
        if some:
            slow = [pytest.mark.slow] if any(one.has("slow") for one in some) or page.name in SLOW else []
            found.append(pytest.param(page, id=page.name, marks=slow))
    return found


SLOW = (
    "README.md",
    "calibrate.md",
    "check.md",
    "instruments.md",
    "learn.md",
    "map.md",
    "plan.md",
    "start.md",
    "trace.md",
    "track.md",
    "train.md",
)
"""Pages whose blocks take a second or more together."""


@pytest.mark.parametrize("page", cases())
def test_blocks_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, traced_once: Callable) -> None:
    if page.name == "trace.md":  # in the shell and in Python
        monkeypatch.setattr("armflex.cli.trace_command.trace", traced_once)
        monkeypatch.setattr(armflex, "trace", traced_once)
    (tmp_path / "robots").symlink_to(ROBOTS, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for one in blocks(page):
        if one.file:
            Path(one.file).write_text(one.text)
        elif one.language == "toml":
            assert tomllib.loads(one.text)
        elif one.language == "python":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", armflex.ArmflexWarning)
                exec(compile(one.text, f"{page.name}:{one.text[:30]!r}", "exec"), names)
        else:
            for line in one.text.replace("\\\n", " ").splitlines():
                program, *arguments = shlex.split(line, comments=True) or [""]
                if program:
                    assert program == "armflex", f"{line!r} is no command of armflex: say why it is not run"
                    done = run_here(tmp_path, *arguments)
                    assert done.returncode == int(one.has("exit 1")), (line, done.stdout, done.stderr)


def test_every_block_says_why_it_is_not_run() -> None:
    for page in PAGES:
        for said, language, text in BLOCK.findall(page.read_text()):
            if language in ("python", "console") and "<!-- not run" in said:
                assert re.search(r"<!-- not run: \w.* -->", said), (page.name, text)


def test_lines_of_code_fit_the_page() -> None:
    """What is copied from a page is in sight without scrolling: a window of 1280 pixels shows 88 characters."""
    wide = [
        (page.name, line)
        for page in PAGES
        for _, language, text in BLOCK.findall(page.read_text())
        for line in text.splitlines()
        if language in RUN and len(line) > 88
    ]
    assert not wide


@pytest.mark.filterwarnings("ignore:partly_certain:armflex.ArmflexWarning")
def test_every_key_and_column_has_a_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the readers ask for while they read docs/formats stands in `docs/_ext/keys.py`."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    import formats

    asked, read = formats.arm_keys(), formats.columns()
    assert formats.undescribed(asked, read) == []
    assert len(asked["flexure.NAME"]) > 10 and "q_JOINT" in read["trajectory.csv"]


@pytest.mark.slow
def test_every_named_effect_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of effects puts each law to work on the bundled boom, and offers the rest to the others."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    import effects

    found, _ = effects.shown()
    assert len(found) >= 30
    assert all(0.0 < one.left <= 1.0 for one in found.values())
    scale, sessions = found["tracker_scale"], found["session_frame"]
    assert sessions.left < scale.left < 0.5  # a frame is calibrated
    assert any("friction_windup" in name for name, _ in found["backlash"].alike)


@pytest.mark.slow
def test_pages_are_in_the_contents() -> None:
    listed = re.findall(r"^(?:[\w ]+ <)?([\w-]+)>?$", (ROOT / "docs" / "index.md").read_text(), re.M)
    pages = {page.stem for page in (ROOT / "docs").glob("*.md")} - {"index"}
    assert pages <= set(listed), f"docs/index.md does not list {sorted(pages - set(listed))}"
