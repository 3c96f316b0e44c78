"""Documentation and messages use the words of the field: none of those that docs/glossary.md lists as not used."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import armflex

PACKAGE = Path(armflex.__file__).parent
ROOT = PACKAGE.parent
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TABLE = re.compile(r"^\| write \| not \|\n\|[-|]+\|\n((?:\|.*\n)+)", re.M)
CODE = re.compile(r"^```.*?^```|`[^`]*`|<!--.*?-->", re.M | re.S)
NEWLINE = "\n"
UNSAID = re.compile(r"<(?:script|style).*?</(?:script|style)>|<[^>]*>", re.S)
"""Of a template of a page: what is not text."""


def not_used() -> re.Pattern[str]:
    (rows,) = TABLE.findall(GLOSSARY.read_text())
    words = [word.strip() for row in rows.splitlines() for word in row.split("|")[2].split(",")]
    assert len(words) > 20
    spaced = (r"\s+".join(map(re.escape, word.split())) for word in words)
    return re.compile(rf"\b(?:{'|'.join(spaced)})\b", re.I)


def messages(code: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of what users may read: strings with a blank, and the help of commands."""
    tree = ast.parse(code)
    silent = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # documentation of the code
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any("command(" in ast.unparse(one) for one in node.decorator_list):
            silent -= {node.body[0].value} if isinstance(node.body[0], ast.Expr) else set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value and node not in silent:
            yield node.lineno, node.value


def texts() -> Iterator[tuple[Path, int, str]]:
    for page in PAGES:
        text = page.read_text()
        if page == GLOSSARY:
            text = TABLE.sub("", text)
        yield page, 1, CODE.sub(lambda found: "\n" * found[0].count("\n"), text)
    for template in sorted((PACKAGE / "show" / "report").glob("*.html")):
        yield template, 1, UNSAID.sub(lambda found: "\n" * found[0].count("\n"), template.read_text())
    for module in sorted(PACKAGE.rglob("*.py")):
        for line, text in messages(module.read_text()):
            yield module, line, text


def test_docs_and_messages_use_the_words_of_the_field() -> None:
    words = not_used()
    found = [
        f"{path.relative_to(ROOT)}:{line + text[: hit.start()].count(NEWLINE)}: {hit[0]!r}"
        for path, line, text in texts()
        for hit in words.finditer(text)
    ]
    assert not found, "words that docs/glossary.md lists as not used:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ('say(f"{a} is told from {b}")', [" is told from "]),
        ('raise InputError("none\\nis told")', ["none\nis told"]),
        ('def f():\n    """Told to nobody but who reads the code."""\n', []),
        ('@click.command()\ndef f():\n    """Told by --help."""\n', ["Told by --help."]),
        ('found["told_by_tip"]', []),
    ],
)
def test_what_counts_as_a_message(code: str, expected: list[str]) -> None:
    assert [text for _, text in messages(code)] == expected
