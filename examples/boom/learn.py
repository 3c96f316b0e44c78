"""Laws from the tables: the paper's three models for every joint, and the errors of each.

    python learn.py FOLDER

reads the tables in FOLDER, and writes beside them NAME.safetensors (what learned.toml names), M1.toml's numbers and
errors.csv: training, held-out and new-load errors of the parametric model, the network and the Bayesian network.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import armflex
from armflex.bench.fitted import predicted, stated_std
from armflex.bench.learners import Options, learner
from armflex.laws.law import Law
from armflex.laws.law_file import TrainedLaw
from armflex.measured.joint_data import JointData

NAMES = ("M1", "A1", "A2", "A3", "A4", "A5", "A6", "A4_upper", "A4_lower")
NEURONS = 10
MODELS = {
    "parametric": ("linear", Options(structure="diagonal")),
    "full linear": ("linear", Options()),
    "ANN": ("neural", Options(neurons=NEURONS, starts=3)),
    "Bayesian ANN": ("bayesian", Options(neurons=NEURONS)),
}


def errors(law: Law, data: JointData) -> np.ndarray:
    """Return the (k,) RMS error in the table's units."""
    return np.sqrt((((data.deflections - predicted(law, data.loads)) / data.factors) ** 2).mean(axis=0))


def main(folder: Path, names: tuple[str, ...] = NAMES) -> None:
    """Train on each table, and compare on its new loads, which no model has."""
    lines = ["joint,model,rows,error,dx_mm,dy_mm,dz_mm,rx_mrad,ry_mrad,rz_mrad"]
    for name in names:
        data, new = (armflex.read_joint_data(folder / f"{name}{part}.csv") for part in ("", "_new"))
        size = np.sqrt(((new.deflections / new.factors) ** 2).mean(axis=0))
        lines.append(f"{name},the data's own RMS,{len(new)},new," + ",".join(f"{x:.4g}" for x in size))
        for model, (kind, options) in MODELS.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fitted = learner(kind, options)(data.loads, data.deflections, 0)
            for part, rows in (("training", data), ("new", new)):
                rms = errors(fitted.law, rows)
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
        print("\n".join(lines[-10:]), flush=True)
    (folder / f"errors{'' if names == NAMES else '_' + names[0]}.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), tuple(sys.argv[2:]) or NAMES)
