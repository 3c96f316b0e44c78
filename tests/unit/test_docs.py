"""What the pages say works: every code block runs, and every key and column that a reader asks for has a meaning."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from support.command_line import run_here
from support.page_blocks import APART, BLOCK, PAGES, ROOT, RUN, blocks, run_page

import armflex


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
    monkeypatch.chdir(tmp_path)
    run_page(page, partial(run_here, tmp_path))


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
