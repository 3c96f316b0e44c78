"""Documentation, docstrings and messages use none of the words that docs/glossary.md lists as not used."""

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
NAMES = re.compile(r"`[^`]*`|^ *\w+(?:, \w+)*:(?= )", re.M)
"""In a docstring: names of code, and of arguments and attributes."""
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
    """Yield line and text of what people may read: strings with a blank, docstrings without the code in them."""
    tree = ast.parse(code)
    documented = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, NAMES.sub("", node.value) if node in documented else node.value


def texts() -> Iterator[tuple[Path, int, str]]:
    for page in PAGES:
        text = page.read_text()
        if page == GLOSSARY:
            text = TABLE.sub("", text)
        yield page, 1, CODE.sub(lambda found: "\n" * found[0].count("\n"), text)
    for template in sorted((PACKAGE / "show" / "report").glob("*.html")):
        yield template, 1, UNSAID.sub(lambda found: "\n" * found[0].count("\n"), template.read_text())
    for module in [*sorted(PACKAGE.rglob("*.py")), ROOT / "docs" / "_ext" / "keys.py"]:
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


def names(code: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of what code binds: variables, arguments, functions, classes and attributes."""
    for node in ast.walk(ast.parse(code)):
        bound = isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store)
        name = {ast.Name: "id", ast.Attribute: "attr", ast.arg: "arg"}.get(type(node), "name")
        if bound or isinstance(node, ast.arg | ast.FunctionDef | ast.ClassDef):
            yield node.lineno, str(getattr(node, name))


def test_names_say_what_is_known_and_not_what_is_told() -> None:
    words = {"tell", "tells", "told", "telling", "untold"}
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, name in names(path.read_text("utf-8"))
        if words & set(name.split("_"))
    ]
    assert not found


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ('say(f"{a} is told from {b}")', [" is told from "]),
        ('raise InputError("none\\nis told")', ["none\nis told"]),
        ('def f():\n    """Told by `told`.\n\n    told: It."""\n', ["Told by .\n\n It."]),
        ('found["told_by_tip"]', []),
    ],
)
def test_what_counts_as_a_message(code: str, expected: list[str]) -> None:
    assert [text for _, text in messages(code)] == expected
