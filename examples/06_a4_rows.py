"""What the 20 printed rows of joint A4 say: a diagonal compliance, what it lacks, what then remains, all left one out.

The paper calls the joint highly non-linear. The rows say: coupled axes first, then something even in the load.
"""

import sys

import numpy as np

import armflex
from armflex.bench.learners import Options

MODELS = {
    "diagonal, the paper's eq. (7)": ("linear", "diagonal", Options()),
    "full 3 x 3": ("linear", "full", Options()),
    "full + radial load": ("polynomial", "full", Options(features=("radial",))),
    "full + radial load + |F|": ("polynomial", "full", Options(features=("radial", "magnitude"))),
    "terms as found, the search left one out too": ("polynomial", "full", Options(features=("found",))),
}


def figure(path: str, errors: dict[str, np.ndarray]) -> None:
    """Draw the held-out error of every model per axis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    canvas, axes = pyplot.subplots(figsize=(8.0, 3.6), layout="constrained")
    for i, (name, rms) in enumerate(errors.items()):
        axes.barh(np.arange(3) + 0.16 * i, rms, 0.15, label=name)
    axes.set(yticks=np.arange(3) + 0.32, yticklabels=("x", "y", "z"), xlabel="RMS, left one out [mm]", xscale="log")
    axes.invert_yaxis()
    axes.legend(fontsize=8)
    canvas.savefig(path, dpi=120)


def main(path: str | None = None) -> dict[str, np.ndarray]:
    data = armflex.read_joint_data(armflex.bundled_robot("tarm_like") / "a4_table_1.csv")
    results = {name: armflex.train(data, *asked) for name, asked in MODELS.items()}
    for name, result in results.items():
        x, y, z = result.held_out_rms
        print(f"{name:45} {x:.3f} / {y:.3f} / {z:.3f} mm")
    found = results["terms as found, the search left one out too"].parameters
    for term in found["terms"]:
        print(f"lacked: {term['name']} (evidence {term['evidence']:.0f}, chance reaches {term['chance']:.0f})")
    errors = {name: result.held_out_rms for name, result in results.items()}
    if path:
        figure(path, errors)
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:])
