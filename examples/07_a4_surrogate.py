"""The paper's comparison of joint models, its Table 2 and figures 4 to 9, on a SURROGATE of its unpublished data.

`python examples/07_a4_surrogate.py [folder]` writes the figures and prints the tables, in a few minutes; "quick" as a
second argument takes half a minute and leaves NUTS out, which needs the extra `bayes`. What is assumed is in
`a4/surrogate.py`. The numbers say how the models compare where a network is needed, not how joint A4 deflects: what
its published rows say is in `06_a4_rows.py`.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from a4 import figures
from a4.study import (
    ANN,
    EVIDENCE,
    LAPLACE,
    NEURONS,
    NUTS,
    PARAMETRIC,
    Trial,
    average,
    fit_all,
    over_benches,
    rms,
    sized,
)
from a4.surrogate import NOISE, Bench, bench

SEED, SEEDS = 0, range(10)
SIZES, QUICK_SIZES = (5, 10, 20, 40), (5, 20)

PRINTED = {
    "parametric": ((5.5863, 27.9727, 2.6825), (14.8158, 30.6032, 0.2154)),
    "ANN": ((0.0498, 0.0020, 0.0445), (0.4695, 0.0420, 1.8766)),
    "Bayesian ANN": ((0.0165, 0.0088, 0.0490), (0.5102, 0.0392, 1.8745)),
}
"""Table 2 of Li et al., RMS along x, y, z on training and on new data, mm by its text."""


@dataclass(frozen=True)
class Outcome:
    """What the study found.

    Attributes:
        new: Model -> (3,) mean over benches of the RMS on new data over the noise.
        exact: The same of the error against the exact deflection.
        coverage: (benches, 3) share of new readings inside the 95 % band of the Bayesian network of 20 neurons.
        density: Neurons -> mean log predictive density of new readings, less that of the truth.
        figures: What was drawn.
        seconds: It took.
    """

    new: dict[str, np.ndarray]
    exact: dict[str, np.ndarray]
    coverage: np.ndarray
    density: dict[int, float]
    figures: list[Path]
    seconds: float


def main(folder: str = "a4_study", quick: bool = False) -> Outcome:
    began, at = time.perf_counter(), bench(SEED)
    sizes = QUICK_SIZES if quick else SIZES
    trials = fit_all(at, SEED, quick)
    table_2(trials, at)
    repeats = over_benches(SEEDS, sizes, quick)
    networks = {size: repeats[sized(size)] for size in sizes}
    table_benches(repeats)
    table_sizes(networks)
    print()
    for name in (sized(NEURONS), EVIDENCE):
        if name in repeats:
            table_coverage(repeats[name])
    drawn = draw(Path(folder), at, trials, repeats, networks)
    return outcome(repeats, networks, drawn, time.perf_counter() - began)


def table_2(trials: Mapping[str, Trial], at: Bench) -> None:
    print("A SURROGATE of the paper's bench: its loads, its published rows' law, two assumed terms, noise", end=" ")
    print(f"{numbers(1e3 * NOISE)} mm.\n\nTable 2, RMS x / y / z [mm]; over the noise: new data, exact deflection")
    for name, rows in PRINTED.items():
        print(f"{'printed: ' + name:27} training {numbers(rows[0])}  new {numbers(rows[1])}")
    print("(printed 27.97 and 30.60 of y: more than any y deflection in Table I, at most 14.12)")
    for name, trial in trials.items():
        score = trial.score
        over = f"{numbers(score.new / NOISE, 2)}  {numbers(score.exact / NOISE, 2)}"
        print(f"{name:27} training {numbers(1e3 * score.training)}  new {numbers(1e3 * score.new)}  over noise {over}")
    training, new = (rms(rows.measured - rows.exact) for rows in (at.training, at.new))
    print(f"{'the exact law':27} training {numbers(1e3 * training)}  new {numbers(1e3 * new)}", end="  ")
    print(f"over noise {numbers(new / NOISE, 2)}")
    if NUTS in trials:
        judged = trials[NUTS].fitted.diagnostics
        print(f"NUTS: R-hat {judged.rhat_max:.3f}, {judged.ess_min:.0f} effective draws", end=", ")
        print(f"{judged.divergences} divergences, {judged.seconds:.0f} s")


def table_benches(repeats: Mapping[str, Sequence[Trial]]) -> None:
    print(f"\nover {len(SEEDS)} benches, error over noise x / y / z: on new data, worst bench, against the exact")
    for name, trials in repeats.items():
        ratios = np.array([trial.score.new for trial in trials]) / NOISE
        exact = average(trials, "exact") / NOISE
        print(f"{name:32} {numbers(ratios.mean(axis=0), 2)}  {numbers(ratios.max(axis=0), 2)}  {numbers(exact, 2)}")


def table_sizes(networks: Mapping[int, Sequence[Trial]]) -> None:
    print("\nneurons, weights, effective ones, log evidence of one maximum,", end=" ")
    print("log density of a new reading less that of the truth (standard error)")
    for size, trials in networks.items():
        weights, used, evidence = (average(trials, of) for of in ("weights", "effective", "log_evidence"))
        density = np.array([trial.score.density for trial in trials])
        error = density.std(ddof=1) / np.sqrt(len(density))
        print(f"{size:3} {weights:4.0f} {used:6.1f} {evidence:8.1f} {density.mean():8.2f} ({error:.2f})")


def table_coverage(trials: Sequence[Trial]) -> None:
    inside = 100.0 * np.array([trial.score.inside for trial in trials])
    each = inside.mean(axis=1)
    print(f"new readings inside the 95 % band of {trials[0].name}: {inside.mean():.1f} %,", end=" ")
    print(f"x / y / z {numbers(inside.mean(axis=0), 1)} %, benches from {each.min():.1f} to {each.max():.1f} %")


def numbers(values: Sequence[float] | np.ndarray, digits: int = 4) -> str:
    return " / ".join(f"{value:.{digits}f}" for value in values)


def draw(
    folder: Path,
    at: Bench,
    trials: Mapping[str, Trial],
    repeats: Mapping[str, Sequence[Trial]],
    networks: Mapping[int, Sequence[Trial]],
) -> list[Path]:
    """Draw every figure; the first six are numbered as the paper's."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = {"parametric": PARAMETRIC, "ann": ANN, "bayesian": NUTS if NUTS in trials else LAPLACE}
    drawn = []
    for i, (short, name) in enumerate(shown.items()):
        for first, what, rows in ((4, "training", at.training), (7, "new", at.new)):
            drawn.append(folder / f"figure_{first + i}_{short}_{what}.png")
            title = f"{name}: {what} data (surrogate)"
            figures.deformation(drawn[-1], title, trials[name].fitted.law, rows, short == "bayesian")
    drawn += [folder / "network_size.png", folder / "benches.png"]
    figures.sizes(drawn[-2], networks)
    figures.benches(drawn[-1], repeats, networks[NEURONS])
    return drawn


def outcome(
    repeats: Mapping[str, Sequence[Trial]], networks: Mapping[int, Sequence[Trial]], drawn: list[Path], seconds: float
) -> Outcome:
    new = {name: average(trials, "new") / NOISE for name, trials in repeats.items()}
    exact = {name: average(trials, "exact") / NOISE for name, trials in repeats.items()}
    coverage = np.array([trial.score.inside for trial in networks[NEURONS]])
    density = {size: float(average(trials, "density")) for size, trials in networks.items()}
    print(f"\n{len(drawn)} figures in {drawn[0].parent}, {seconds:.0f} s")
    return Outcome(new, exact, coverage, density, drawn, seconds)


if __name__ == "__main__":
    main(*sys.argv[1:2], quick="quick" in sys.argv[2:])
