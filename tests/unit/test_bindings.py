"""Names that say nothing of what they hold: how often the package binds them may fall, not rise."""

import ast
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "armflex"
EMPTY = {"one", "found", "own", "known", "some"}
MOST = 448
"""Bindings of such names: arguments, variables, targets of loops and of comprehensions, fields of classes."""


def bound(source: str) -> Counter[str]:
    """Return how often a module binds each of the names."""
    names: Counter[str] = Counter()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.arg):
            names[node.arg] += 1
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names[node.id] += 1
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            names[node.name] += 1
    return Counter({name: times for name, times in names.items() if name in EMPTY})


def test_every_way_to_bind_a_name_is_counted() -> None:
    source = """
class Field:
    own: float
def function(one, *some, known=0, **found):
    for own, (one, _) in known: pass
    with open(one) as found: pass
    some: int = (known := 1)
    return [one for one, own in some], lambda known: known
"""
    assert bound(source) == {"one": 3, "own": 3, "found": 2, "known": 3, "some": 2}


def test_names_are_of_quantities() -> None:
    counts = {path: bound(path.read_text(encoding="utf-8")).total() for path in PACKAGE.rglob("*.py")}
    worst = sorted(((count, path.relative_to(PACKAGE).as_posix()) for path, count in counts.items()), reverse=True)
    assert sum(counts.values()) <= MOST, worst[:10]
