"""README, pages and pictures state one figure for one thing: that of docs/results/figures.toml, with its command."""

import re
import tomllib
from pathlib import Path

import pytest
from support.small_arms import ROBOTS

ROOT = ROBOTS.parent
FIGURES = tomllib.loads((ROOT / "docs" / "results" / "figures.toml").read_text())
ALL = [*FIGURES["arm"], *FIGURES["count"]]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "notebooks").glob("*.py")),
    ROOT / "docs" / "_static" / "before_after.svg",
]


def value(figure: dict, name: str) -> str:
    """Return a value as the pages have it: as written, the sum over the seeds, or its share in per cent."""
    if "seeds" not in figure:
        return name
    total = sum(figure[name.removesuffix(" %")])
    return f"{100.0 * total / sum(figure['observable']):.1f}" if name.endswith(" %") else str(total)


def statements(pattern: str, page: Path) -> list[tuple[str, ...]]:
    """Return what a page states where a pattern fits."""
    return [found.groups() for found in re.finditer(pattern, re.sub(r"\s+", " ", page.read_text()))]


@pytest.mark.parametrize("figure", ALL, ids=[figure["of"] for figure in ALL])
def test_pages_state_the_figures_of_the_one_source(figure: dict) -> None:
    assert figure["command"]
    expected = tuple(value(figure, name) for name in figure["values"])
    stated = {page.relative_to(ROOT).as_posix(): statements(figure["pattern"], page) for page in PAGES}
    others = [(page, values) for page, several in stated.items() for values in several if values != expected]
    assert not others, f"{figure['of']}: docs/results/figures.toml has {expected}"
    assert {page for page in figure["pages"] if not stated[page]} == set()


@pytest.mark.parametrize("figure", FIGURES["count"], ids=[figure["of"] for figure in FIGURES["count"]])
def test_the_table_of_seeds_has_the_numbers_that_are_summed(figure: dict) -> None:
    lines = (ROOT / "docs" / "validation.md").read_text().splitlines()
    for name, label in figure["rows"].items():
        assert len(figure[name]) == len(figure["seeds"])
        cells = next(line.split("|")[1:-1] for line in lines if line.startswith(f"| {label} |"))
        numbers = [int(re.findall(r"\d+", cells[column])[0]) for column in figure["columns"]]
        assert numbers == figure[name][: len(numbers)], (figure["of"], label)
