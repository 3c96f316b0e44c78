"""How often stated probabilities are right: a table and a picture from the tables of `study.py`.

    python tests/studies/study.py --draws 350 --seed 6000 -o study.csv         # continued where it was ended
    python tests/studies/reliability.py study.csv --picture reliability.svg

Every name of every credible set counts once, and so does that nothing is missing.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from armflex.plotting import picture

sys.path.insert(0, str(Path(__file__).parents[1]))

from studies.study import Score, read_scores

FEWEST = 20
"""Statements of which a decile is judged."""

LEAST = 1e-4
"""Probability below which a statement of it counts as this one in the log score."""


def deciles(stated: np.ndarray) -> list[tuple[int, float, float]]:
    """Return of (N, 2) probabilities and outcomes by decile how many there are, their mean, and how many are right."""
    which = np.minimum((10.0 * stated[:, 0]).astype(int), 9)
    return [
        (int((which == i).sum()), *(stated[which == i].mean(axis=0) if (which == i).any() else (np.nan, np.nan)))
        for i in range(10)
    ]


def statements(scores: Sequence[Score]) -> np.ndarray:
    """Return (N, 2) probabilities that were stated of names and of nothing, and whether each was right."""
    return np.array([pair for one in scores if one.verdict != "ERROR" for pair in one.stated], float)


def log_score(stated: np.ndarray) -> float:
    """Return the mean logarithm of the probability that was given to what is true."""
    given = np.where(stated[:, 1] > 0.5, stated[:, 0], 1.0 - stated[:, 0])
    return float(np.log(np.clip(given, LEAST, 1.0)).mean())


def draw(path: Path, found: list[tuple[int, float, float]]) -> None:
    """Draw frequency against probability, with two standard deviations of the counts; few statements are hollow."""
    with picture(path, 4.2, 4.0, 150.0) as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color="0.7", lw=1)
        for n, mean, right in found:
            if not n:
                continue
            error, fill = 2.0 * np.sqrt(mean * (1.0 - mean) / n), "C0" if n >= FEWEST else "white"
            axes.errorbar(mean, right, error, fmt="o", ms=5, capsize=2, color="C0", markerfacecolor=fill)
            axes.annotate(str(n), (mean, right), xytext=(6, -10), textcoords="offset points", fontsize=8)
        axes.set(xlabel="probability stated", ylabel="share that is right", xlim=(-0.05, 1.1), ylim=(-0.1, 1.1))
        axes.grid(alpha=0.25)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", type=Path, nargs="+")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(arguments)
    scores = [one for path in given.tables for one in read_scores(path) if one.verdict != "ERROR"]
    stated = statements(scores)
    sets = np.array([pair for one in scores for pair in one.sets], float)
    found = deciles(stated)
    print(f"{len(scores)} draws, {len(stated)} statements")
    print("stated       number  mean stated  right")
    for i, (count, mean, right) in enumerate(found):
        doubt = " (few)" if count < FEWEST else ""
        print(f"{i / 10:.1f} to {i / 10 + 0.1:.1f}   {count:6d}  {mean:11.3f}  {right:5.3f}{doubt}")
    print(f"log score {log_score(stated):.4f}")
    print(f"95 % sets hold a hidden effect: {sets[:, 0].mean():.1%} of {len(sets)}, {sets[:, 1].mean():.2f} names each")
    if given.picture:
        draw(given.picture, found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
