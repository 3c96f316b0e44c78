"""armflex rehearse: what poses and instruments could show, before anybody drives them."""

from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import number, print_table, progress, say
from armflex.measured.measurements import read_measurements
from armflex.tasks.rehearse import DRAWS, Rehearsal, rehearse, summary

CLEAR, DOUBTFUL = 0.9, 0.5
"""Probability of its own name from which a campaign is said to name an effect, and below which it is said to fail."""


@click.command(cls=options.Command)
@click.argument("arm_path", metavar="ARM", type=options.InputPath)
@click.option("--rows", "rows_path", type=options.InputPath, metavar="POSES.csv", help="[default: 60 rows of plan]")
@click.option("--sigma", type=options.Quantity("length"), default="0.2mm", show_default=True,
              help="Noise of positions.")  # fmt: skip
@click.option("--size", type=options.Quantity("length"), default="1mm", show_default=True, help="Size of effects, RMS.")
@click.option("--draws", type=click.IntRange(min=1), default=DRAWS, show_default=True, help="Campaigns of each effect.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the draws.")
@options.lax
def command(
    arm_path: Path, rows_path: Path | None, sigma: float, size: float, draws: int, seed: int, lax: bool
) -> None:
    """Simulate a campaign with one hidden effect after the other, and report which of them it would name.

    Each effect moves the target by --size RMS, or by less where no machine has so much. All instruments that ARM
    declares are read, and a tracker at the target.
    """
    arm = options.declared_arm(arm_path, "rehearse", lax=lax)
    rows = None if rows_path is None else read_measurements(rows_path, arm, inputs_only=True)
    with progress("rehearsing: effects hidden") as tick:
        rehearsal = rehearse(arm, rows, sigma=sigma, size=size, draws=draws, seed=seed, progress=tick)
    options.conclude(rehearsal.content, ())
    print_rehearsal(rehearsal)


def print_rehearsal(rehearsal: Rehearsal) -> None:
    """Print a line for every law, the hardest to name first, what its columns are, and what these rows cannot show."""
    rows = []
    for name, chances_of in rehearsal.laws:
        named, within, nothing, confused = summary(chances_of)
        size = sum(chance.size for chance in chances_of) / len(chances_of)
        chances = [f"{share:.0%}" for share in (named, nothing, max(1.0 - named - nothing, 0.0))]
        rows.append([name, str(len(chances_of)), number(size * 1e3, 2), *chances, confused or "-", f"{within:.0%}"])
    columns = ["hidden effect", "places", "size mm", "own name", "calibration", "another", "mostly", "in set"]
    print_table(f"Mean probability after {rehearsal.read} rows are read", columns, rows)
    say(
        "Figures are means over the places of an effect, which is called as in [[effect]] of an arm.toml; unnamed_ "
        "begins the name of a shape without a cause.",
        f"size: RMS of how far the effect moves the target, {number(rehearsal.size * 1e3, 3)} mm, or less where no "
        "machine has so much.",
        "own name: probability of the effect itself; calibration: that nothing is missing, because the fitted "
        "parameters take the effect up or the noise hides it; another: of all other effects, mostly the one listed.",
        "in set: share of the campaigns in which the effect is among the likeliest that together have 95 %.",
    )
    clear = sum(effect.named >= CLEAR for effect in rehearsal.effects)
    failed = [effect for effect in rehearsal.effects if effect.named < DOUBTFUL]
    still = sum(effect.size == 0.0 for effect in failed)
    say(
        f"{clear} of {len(rehearsal.effects)} effects would get their own name with a probability of {CLEAR:.0%} or "
        f"more, {len(failed)} with less than {DOUBTFUL:.0%}; {still} do not move what is read at all (size 0)."
    )
