"""Numbers with a name that estimating and tracing rest on: each is of a kind, and no name is two numbers."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "armflex"
ROOMS = ("estimate", "trace")
MOST = {"estimate": 26, "trace": 33}
"""Numbers that each room has at most: there may be fewer, not more."""


def is_number(node: ast.expr, known: set[str]) -> bool:
    """Return whether an expression is made of numbers alone, or of names of such."""
    parts = {
        ast.UnaryOp: lambda: [node.operand],
        ast.BinOp: lambda: [node.left, node.right],
        ast.Tuple: lambda: node.elts,
        ast.List: lambda: node.elts,
        ast.Dict: lambda: node.values,
        ast.Call: lambda: node.args,
    }
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Name):
        return node.id in known
    some = parts.get(type(node), list)()
    return bool(some) and all(is_number(part, known) for part in some)


def numbers(path: Path) -> Iterator[tuple[str, str, str]]:
    """Yield name, value and description of the numbers that a module binds."""
    body, known = ast.parse(path.read_text(encoding="utf-8")).body, set[str]()
    for i, node in enumerate(body):
        if not isinstance(node, ast.Assign):
            continue
        target = node.targets[0]
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        values = node.value.elts if len(names) > 1 and isinstance(node.value, ast.Tuple) else [node.value] * len(names)
        after = next((one for one in body[i + 1 :] if not isinstance(one, ast.Assign)), None)
        said = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        for name, value in zip(names, values, strict=True):
            if isinstance(name, ast.Name) and name.id.isupper() and is_number(value, known):
                known.add(name.id)
                yield name.id, ast.unparse(value), str(said)


def test_each_is_a_prior_a_confidence_or_a_tolerance() -> None:
    for room in ROOMS:
        found = [(path.name, *one) for path in sorted((PACKAGE / room).rglob("*.py")) for one in numbers(path)]
        assert [one for one in found if not one[3].startswith(("Prior", "Confidence", "Tolerance"))] == []
        assert len(found) <= MOST[room]


def test_no_name_is_two_numbers() -> None:
    bound = defaultdict(dict)
    for path in PACKAGE.rglob("*.py"):
        for name, value, _ in numbers(path):
            bound[name][path.relative_to(PACKAGE).as_posix()] = value
    twice = {name: where for name, where in bound.items() if len(set(where.values())) > 1}
    assert {name: where for name, where in twice.items() if any(one.startswith(ROOMS) for one in where)} == {}
