"""Laws from the tables: the paper's three models for every joint, and the errors of each.

    python learn.py FOLDER

reads the tables in FOLDER, and writes beside them NAME.safetensors (what learned.toml names), M1.toml (its flexure of
M1) and errors.csv: training, held-out and new-load errors of the parametric model, the network, the Bayesian network
and of what `auto` chooses. Held out are a fifth of the rows after another; `auto` chooses anew without each.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import armflex
from armflex.bench.cross_validation import hold_out, random_folds
from armflex.bench.fitted import predicted, stated_std
from armflex.bench.learners import Options, learner
from armflex.laws.law import Law
from armflex.laws.law_file import TrainedLaw
from armflex.measured.joint_data import JointData

NAMES = ("M1", "A1", "A2", "A3", "A4", "A5", "A6", "A4_ring")
NEURONS, FOLDS = 10, 5
DEGREE = 7
"""Of M1's polynomials in the extension."""

ACTING = (*((i, i) for i in range(6)), (0, 4), (1, 3))
"""Entries of M1's compliance: of a round mast that hangs along z no others act."""

MODELS = {
    "parametric": ("linear", Options(structure="diagonal")),
    "full linear": ("linear", Options()),
    "ANN": ("neural", Options(neurons=NEURONS, starts=3)),
    "Bayesian ANN": ("bayesian", Options(neurons=NEURONS)),
}


def errors(law: Law, data: JointData) -> np.ndarray:
    """Return the (k,) RMS error in the table's units."""
    return np.sqrt((((data.deflections - predicted(law, data.loads)) / data.factors) ** 2).mean(axis=0))


def mast(file: Path) -> str:
    """Return [flexure.M1]: polynomials in the extension through M1_extension.csv, least squares of relative errors."""
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    extension, compliance = table[::6, 0], table[:, 1:].reshape(-1, 6, 6)
    powers, coefficients = np.vander(extension, DEGREE + 1, increasing=True), np.zeros((DEGREE + 1, 6, 6))
    for i, j in ACTING:
        size = np.sqrt(compliance[:, i, i] * compliance[:, j, j])
        fit = np.linalg.lstsq(powers / size[:, None], compliance[:, i, j] / size, rcond=None)[0]
        coefficients[:, i, j] = coefficients[:, j, i] = fit
    lines = ["[flexure.M1]", 'joint = "M1"', 'model = "position_dependent"', "relative_std = 0.02"]
    for power, matrix in enumerate(coefficients):
        rows = [f"    [{', '.join(f'{x:.12g}' if x else '0.0' for x in row)}]," for row in matrix]
        lines += [f"compliance{f'_q{power}' if power else ''} = [", *rows, "]"]
    return "\n".join(lines) + "\n"


def main(folder: Path, names: tuple[str, ...] = NAMES) -> None:
    """Train on each table, and compare on its new loads, which no model has."""
    lines = ["joint,model,rows,error,dx_mm,dy_mm,dz_mm,rx_mrad,ry_mrad,rz_mrad"]
    if "M1" in names:
        (folder / "M1.toml").write_text(mast(folder / "M1_extension.csv"), encoding="utf-8")
    for name in names:
        data, new = (armflex.read_joint_data(folder / f"{name}{part}.csv") for part in ("", "_new"))
        size = np.sqrt(((new.deflections / new.factors) ** 2).mean(axis=0))
        lines.append(f"{name},the data's own RMS,{len(new)},new," + ",".join(f"{x:.4g}" for x in size))
        for model, (kind, options) in MODELS.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fit = learner(kind, options)
                fitted = fit(data.loads, data.deflections, 0)
                held = hold_out(fit, data, random_folds(len(data), FOLDS, 0)).rms / data.factors
            each = {"training": errors(fitted.law, data), "held out": held, "new": errors(fitted.law, new)}
            for part, rms in each.items():
                rows = new if part == "new" else data
                lines.append(f"{name},{model},{len(rows)},{part}," + ",".join(f"{x:.4g}" for x in rms))
            if model == "Bayesian ANN":
                about = {
                    "armflex": armflex.__version__,
                    "data": f"{name}.csv",
                    "sha256": data.sha256,
                    "rows": len(data),
                }
                armflex.save_law(TrainedLaw(fitted.law, kind, about), folder / f"{name}.safetensors")
                band = 1.96 * stated_std(fitted.law, new.loads)
                inside = np.abs(new.deflections - predicted(fitted.law, new.loads)) <= band
                lines.append(
                    f"{name},{model},{len(new)},share of new inside 95 %,"
                    + ",".join(f"{x:.3f}" for x in inside.mean(axis=0))
                )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            auto = armflex.train(data, "auto", options=Options(neurons=NEURONS, starts=3))
        each = {"training": auto.train_rms, "held out": auto.held_out_rms, "new": errors(auto.trained.law, new)}
        for part, rms in each.items():
            rows = new if part == "new" else data
            lines.append(f"{name},auto,{len(rows)},{part}," + ",".join(f"{x:.4g}" for x in rms))
        lines.append(f"{name},auto,{len(data)},chosen,{auto.parameters['chosen'].replace(', ', ' ')}")
    file = folder / f"errors{'' if names == NAMES else '_' + names[0]}.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(table(file))


def table(file: Path) -> str:
    """Return errors.csv as the page's table: norms of three components in um / urad."""
    found = {}
    for line in file.read_text(encoding="utf-8").splitlines()[1:]:
        name, model, _, error, *values = line.split(",")
        found[name, model, error] = values[0] if error == "chosen" else np.array(values, float)

    def norms(*key: str) -> str:
        return " / ".join(f"{1e3 * np.linalg.norm(part):.3g}" for part in found[key].reshape(2, 3))

    lines = []
    for name in dict.fromkeys(key[0] for key in found):
        cells = [name, norms(name, "the data's own RMS", "new")]
        cells += ["; ".join(norms(name, model, error) for error in ("training", "held out", "new")) for model in MODELS]
        cells[-1] += f"; {100.0 * found[name, 'Bayesian ANN', 'share of new inside 95 %'].mean():.0f} %"
        auto = "; ".join(norms(name, "auto", error) for error in ("training", "held out", "new"))
        lines.append(f"| {' | '.join(cells)} | {found[name, 'auto', 'chosen']}: {auto} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]), tuple(sys.argv[2:]) or NAMES)
