"""Learn joint laws on drawn arms that bend as nobody declared, and set a black box beside them at equal data.

    python tests/studies/learned.py --draws 6 --model polynomial,neural --jobs 2 -o learned.csv

Told at rows that were not used are the error over the noise of the same readings, as RMS and as median; the RMS of the
error without that noise; and of the error over the uncertainty stated. Where poses are held out of the same range, the
95 % bands of the laws are compared with the true ones at the loads of the campaign. A draw that the CSV holds is not
made again.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.bent_joints import Bent, bent
from support.campaigns import SIGMA
from support.plant import Array

from armflex import Arm, Measurements, calibrate, load_arm, predict, read_measurements
from armflex.laws import Row

ARMS = ("boom", "six")
MODELS = ("linear", "polynomial", "neural", "bayesian")
CASES: dict[str, Callable[[Bent], Array]] = {
    "inside": lambda bent: np.zeros(len(bent.drawn.rows.q), bool),
    "middle payload": lambda bent: bent.carrying(1),
    "heaviest payload": lambda bent: bent.carrying(2),
    "corner": lambda bent: bent.corner(),
}
"""What is judged -> the stops that are kept out of the campaign beside the poses that always are."""

CALIBRATED, BLACK_BOX, ON_TOP = "not learned", "black box", "black box on residual"


@dataclass(frozen=True)
class Told:
    """How well a model tells readings that were not used.

    Attributes:
        arm, seed, case, model: What was drawn, what is judged, who tells.
        used, rows: Readings used, and judged.
        rms, median: Of the error over those of the noise.
        true: RMS of the error without noise over the RMS of the noise.
        z: RMS of the error over its stated standard uncertainty, the noise's included.
        bent, turns: Share of loads at which the 95 % band has the true twist: of the axes that bend, of all rotations.
        seconds: To calibrate or to train.
    """

    arm: str
    seed: int
    case: str
    model: str
    used: int
    rows: int
    rms: float
    median: float
    true: float
    z: float = np.nan
    bent: float = np.nan
    turns: float = np.nan
    seconds: float = np.nan


@dataclass(frozen=True)
class Campaign:
    """A drawn campaign with some stops kept out."""

    drawn: Bent
    case: str
    folder: Path

    def arm(self, model: str) -> tuple[Arm, Measurements, Measurements]:
        """The declared arm that learns a model, the campaign, and what is judged."""
        arm = load_arm(self.drawn.write(self.folder, model, CASES[self.case](self.drawn)))
        judged = "test" if self.case == "inside" else "unseen"
        return arm, *(read_measurements(self.folder / f"{name}.csv", arm) for name in ("train", judged))

    def told(self, model: str, rows: Measurements, position: Array, **more) -> Told:
        """How well (N, 3) positions tell the readings."""
        read, drawn = np.flatnonzero(rows.measured), self.drawn.drawn
        noise = drawn.errors[read]
        size, chance, away = (
            np.linalg.norm(part, axis=1)
            for part in ((rows.position - position)[read], noise, (rows.position - drawn.errors - position)[read])
        )
        ratios = _rms(size) / _rms(chance), np.median(size) / np.median(chance), _rms(away) / _rms(chance)
        used = int((drawn.rows.measured & ~CASES[self.case](self.drawn)).sum())
        return Told(drawn.arm, drawn.seed, self.case, model, used, len(read), *map(float, ratios), **more)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def learned(campaign: Campaign, model: str) -> tuple[Told, Arm]:
    """Calibrate with laws of a model, "none" for none to be learned."""
    arm, used, judged = campaign.arm(model)
    start = time.time()
    found = calibrate(arm, used).arm
    seconds = time.time() - start
    there, read = predict(found, judged), judged.measured
    z = ((judged.position - there.position) / np.hypot(there.sigma, SIGMA))[read]
    shares = covered(campaign.drawn, found) if model != "none" and campaign.case == "inside" else (np.nan, np.nan)
    more = {"z": _rms(z), "bent": shares[0], "turns": shares[1], "seconds": seconds}
    return campaign.told(CALIBRATED if model == "none" else model, judged, there.position, **more), found


def covered(drawn: Bent, arm: Arm) -> tuple[float, float]:
    """Shares of the loads at which the band has the true twist: of the axes that bend, and of all rotations."""
    state, names = drawn.state(), list(arm.joint_names)
    row = Row(drawn.drawn.rows.q, {name: i for i, name in enumerate(names)})
    bending, turning = [], []
    for joint, axis in zip(drawn.joints, drawn.axes, strict=True):
        law, loads = arm.flexures[names.index(joint)].law, state.wrenches[:, names.index(joint)]
        band = 1.96 * np.sqrt(np.diagonal(law.covariance(loads, row), axis1=1, axis2=2))
        within = np.abs(law.twist(loads, row) - drawn.twist(joint, loads)) <= band
        bending.append(within[:, axis].mean())
        turning.append(within[:, 3:].mean())
    return float(np.mean(bending)), float(np.mean(turning))


def black_boxes(campaign: Campaign, calibrated: Arm) -> list[Told]:
    """Train networks on the displacement of the tip, and on what the calibrated arm leaves of it.

    Both are given what calibration found of the instrument and of the joints' zeros.
    """
    from support.black_box import inputs, train_black_box  # torch takes as long as all else

    _, used, judged = campaign.arm("none")
    drawn = campaign.drawn.drawn
    x = inputs(drawn.rows, [joint.kind == "prismatic" for joint in drawn.plant.joints])
    read, instrument, told = used.measured, calibrated.instrument, []
    turns = instrument.rotations(np.tile(np.eye(4), (len(x), 1, 1)), used.session)
    rigid = replace(calibrated, flexures=(), certainty=None)
    for name, arm in ((BLACK_BOX, rigid), (ON_TOP, replace(calibrated, certainty=None))):
        start, without = time.time(), predict(arm, used).position
        y = np.einsum("nji,nj->ni", turns, used.position - without)  # base axes
        found = train_black_box(x[read], y[read], drawn.rows.pose[read])
        position = without + np.einsum("nij,nj->ni", turns, found(x))
        told.append(campaign.told(name, judged, position, seconds=time.time() - start))
    return told


def draw(arm: str, seed: int, models: Sequence[str], cases: Sequence[str] = tuple(CASES)) -> list[Told]:
    """Return what everybody tells of one drawn arm."""
    told, drawn = [], bent(seed, arm)
    for case in cases:
        with tempfile.TemporaryDirectory() as folder:
            campaign = Campaign(drawn, case, Path(folder))
            plain, calibrated = learned(campaign, "none")
            told += [plain, *(learned(campaign, model)[0] for model in models), *black_boxes(campaign, calibrated)]
    return told


def read_told(path: Path) -> list[Told]:
    """Return what a file holds, nothing where there is none."""
    if not path.exists():
        return []
    kinds = {"arm": str, "case": str, "model": str, "seed": int, "used": int, "rows": int}
    names = [field.name for field in fields(Told)]
    with path.open(newline="") as file:
        return [Told(**{name: kinds.get(name, float)(row[name]) for name in names}) for row in csv.DictReader(file)]


def append(path: Path, told: Sequence[Told]) -> None:
    """Add rows, the header first."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Told)])
        if new:
            writer.writeheader()
        writer.writerows(asdict(one) for one in told)


def run(draws: int, first: int, models: Sequence[str], path: Path, workers: int) -> list[Told]:
    """Make every draw that the file does not hold, the arms in turn."""
    wanted = [(ARMS[i % len(ARMS)], first + i // len(ARMS)) for i in range(draws)]
    shown = (CALIBRATED, *models, BLACK_BOX, ON_TOP)
    known = {(one.arm, one.seed) for one in read_told(path) if one.model in models}
    missing = [job for job in wanted if job not in known]
    finished = Parallel(n_jobs=workers, return_as="generator_unordered")(delayed(draw)(*job, models) for job in missing)
    for told in finished:
        append(path, told)
        print(f"\n{told[0].arm} {told[0].seed}\n{table(told)}", flush=True)
    return [one for one in read_told(path) if (one.arm, one.seed) in wanted and one.model in shown]


HEADER = f"{'':42s}draws  RMS/noise median worst  median/noise  true/noise     z   bent  turns     s"


def table(told: Sequence[Told]) -> str:
    """Return one line per case and model, means over the draws but for what is called median."""
    lines = [HEADER]
    for case, model in dict.fromkeys((one.case, one.model) for one in told):
        some = [one for one in told if (one.case, one.model) == (case, model)]
        rms = [one.rms for one in some]
        mean = {name: np.mean([getattr(one, name) for one in some]) for name in ("median", "true", "z", "seconds")}
        bands = [np.mean([getattr(one, name) for one in some]) for name in ("bent", "turns")]
        lines.append(
            f"{case:18s}{model:24s}{len(some):5d} {np.mean(rms):10.3f} {np.median(rms):6.3f} {np.max(rms):5.2f} "
            f"{mean['median']:13.3f} {mean['true']:11.3f} {mean['z']:5.2f} {bands[0]:6.1%} {bands[1]:6.1%} "
            f"{mean['seconds']:5.1f}"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=6)
    parser.add_argument("--model", default="polynomial,neural", help=f"comma-separated, of {', '.join(MODELS)}")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("-o", "--output", type=Path, default=Path("learned.csv"))
    given = parser.parse_args(arguments)
    models = [name.strip() for name in given.model.split(",")]
    unknown = sorted(set(models) - set(MODELS))
    if unknown:
        parser.error(f"unknown models: {', '.join(unknown)}; known: {', '.join(MODELS)}")
    print(f"\n{table(run(given.draws, given.seed, models, given.output, given.jobs))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
