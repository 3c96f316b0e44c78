"""The pages as tests read them: their blocks of code, which run in order in one folder.

A comment before a block says what is special about it: `<!-- file: NAME -->` it is that file, `<!-- exit 1 -->` its
commands end so, `<!-- slow: WHY -->` it takes its time, `<!-- not run: WHY -->`.
"""

import re
import shlex
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import NamedTuple

import armflex
from support.small_arms import ROBOTS

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

    @property
    def commands(self) -> list[list[str]]:
        """The words of every line of a console."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def blocks(page: Path) -> list[Block]:
    found = [Block(language, text, said) for said, language, text in BLOCK.findall(page.read_text())]
    return [one for one in found if (one.language in RUN or one.file) and not one.has("not run")]


def run_page(page: Path, run: Callable[..., CompletedProcess[str]]) -> None:
    """Run the blocks of a page in this folder, commands by `run(*arguments)`."""
    Path("robots").symlink_to(ROBOTS, target_is_directory=True)
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
            for program, *arguments in one.commands:
                assert program == "armflex", f"{program!r} is no command of armflex: say why it is not run"
                done = run(*arguments)
                assert done.returncode == int(one.has("exit 1")), (arguments, done.stdout, done.stderr)
