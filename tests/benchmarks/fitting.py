"""Fitting a measured arm: `armflex` beside FIGAROH on the same simulated campaigns, by the error on poses held out.

    OPENBLAS_NUM_THREADS=1 python tests/benchmarks/fitting.py

The campaigns are made by tests/support/plant.py, which shares code with neither, for the six-axis arm; noise is 0.2 mm
per axis, 0.346 mm in 3-D. `within reach` has only what FIGAROH can express: joint offsets, a tool, and drives that give
about their own axis, one payload, one stand of the tracker. The others are campaigns of the tests: compliances in six
directions, three payloads, five sessions, and backlash or a gear's error that nobody declared. FIGAROH knows a load
only as part of the URDF, so it is given the mean payload, or fits once per payload; every error is over all held-out
rows. It fits elasticity with joint offsets only: with six geometric errors per joint and an unknown base frame, the
names of the base frame replace those of the first six parameters, which are the elasticities of a six-axis arm.
"""

import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent.parent))

from baseline import machine
from figaroh_fit import Model, fit, with_payload
from support.campaign_files import ROBOTS
from support.campaigns import draw
from support.plant import Campaign, Plant

import armflex
from armflex import Arm, Measurements, Payload
from armflex.conventions import Array

SEEDS = (1, 2, 3)
TRAINED, POSES = 90, 120
DRIVES = {"J1": (5, 4e-7), "J2": (4, 3e-7), "J3": (4, 4.5e-7), "J4": (3, 1.8e-6), "J5": (4, 2e-6), "J6": (3, 3e-6)}
"""Axis and compliance [rad/Nm] of every drive, as declared."""
HELD = ("p120", 120.0, (0.15, 0.0, 0.04))
MODELS = {"offsets, elasticity": Model("joint_offset", True), "geometry": Model("full_params", False)}
Line = tuple[str, float, float]
"""What fitted, the held-out RMS [m], the time [s]."""


def within_reach(seed: int, folder: Path) -> tuple[Path, Path, Path]:
    """Write a campaign of joint offsets and drives that give; return arm.toml, the rows to fit and those held out."""
    (folder / "arm.toml").write_text(drives_only_arm())
    plant, rng = Plant.read(folder / "arm.toml"), np.random.default_rng([seed, 7])
    plant.compliance = {name: given * np.exp(rng.normal(0.0, 0.2)) for name, given in plant.compliance.items()}
    plant.offset = {joint.name: float(rng.normal(0.0, 1e-3)) for joint in plant.joints}
    plant.target = rng.normal(0.0, 5e-3, 3)
    Campaign(seed, POSES, sessions=1, payloads=(HELD,)).write(plant, folder / "all.csv")
    head, *rows = (folder / "all.csv").read_text().splitlines(keepends=True)
    for name, part in (("train.csv", rows[:TRAINED]), ("test.csv", rows[TRAINED:])):
        (folder / name).write_text(head + "".join(part))
    return folder / "arm.toml", folder / "train.csv", folder / "test.csv"


def drives_only_arm() -> str:
    """Return an arm.toml of the six-axis arm whose drives give and nothing else."""
    lines = ["[robot]", f'urdf = "{(ROBOTS / "heavy_six" / "robot.urdf").as_posix()}"', 'tip = "tool"', 'base = "base"']
    lines += ["gravity = [0.0, 0.0, -9.81]", f"[payload.{HELD[0]}]", f"mass = {HELD[1]}", f"com = {list(HELD[2])}"]
    for name, (axis, compliance) in DRIVES.items():
        values = (compliance * np.eye(6)[axis]).tolist()
        lines += [f"[flexure.{name}]", f'joint = "{name}"', 'model = "linear"', f"compliance = {values}"]
    lines += ["[measurement]", 'frame = "unknown"', 'gravity_in = "base"', "[prior]"]
    lines += ["joint_offset = 1e-3", "compliance = 0.2", "tool = 0.005"]
    return "\n".join(lines) + "\n"


def undeclared(kind: str) -> Callable[[int, Path], tuple[Path, Path, Path]]:
    """Return what writes a campaign of the tests with that effect."""

    def make(seed: int, folder: Path) -> tuple[Path, Path, Path]:
        truth = draw(kind, seed, "six").write(folder)
        return truth.arm, truth.train, truth.test

    return make


CAMPAIGNS = {
    "within reach": within_reach,
    "backlash undeclared": undeclared("backlash"),
    "gear error undeclared": undeclared("gear_harmonic"),
}


def rms(errors: Array) -> float:
    """Return the 3-D RMS of (N, 3) errors."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def own_lines(arm: Arm, train: Measurements, test: Measurements) -> Iterator[Line]:
    """Yield armflex's lines."""

    def held_out(fitted: Arm) -> float:
        read = test.measured
        return rms(armflex.predict(fitted, test).position[read] - test.position[read])

    for name, work in (("armflex calibrate", armflex.calibrate), ("armflex trace", armflex.trace)):
        start = time.process_time()
        found = work(arm, train)
        yield name, held_out(found.arm), time.process_time() - start


def figaroh_version() -> str | None:
    """Return which is installed, None where it is not."""
    try:
        return version("figaroh")
    except PackageNotFoundError:
        return None


def figaroh_lines(arm: Arm, train: Measurements, test: Measurements) -> Iterator[Line]:
    """Yield FIGAROH's lines: the mean payload, and where there are several each apart; none where it is missing."""
    if figaroh_version() is None:
        return
    masses = [arm.payload(name).mass for name in train.payload]
    mean = Payload(float(np.mean(masses)), arm.payload(train.payload[0]).com)
    names = sorted(set(train.payload))
    for title, model in MODELS.items():
        yield f"FIGAROH, {title}", *fit_group(arm, mean, model, train, test, None)
        if len(names) > 1:
            parts = [fit_group(arm, arm.payload(name), model, train, test, name) for name in names]
            counts = [int((test.measured & chosen(test, name)).sum()) for name in names]
            together = np.sqrt(np.average([error**2 for error, _ in parts], weights=counts))
            yield f"FIGAROH, {title}, per payload", float(together), sum(seconds for _, seconds in parts)


def fit_group(
    arm: Arm, payload: Payload, model: Model, train: Measurements, test: Measurements, name: str | None
) -> tuple[float, float]:
    """Return held-out RMS [m] and time [s] of one FIGAROH fit to the rows of one payload, or to all."""
    used, judged = (rows.measured & chosen(rows, name) for rows in (train, test))
    with tempfile.TemporaryDirectory() as written:
        folder = Path(written)
        with_payload(arm.robot.urdf.path, arm.robot.tip, payload, folder / "robot.urdf")
        q, seen = train.q[used], train.position[used]
        found = fit(folder / "robot.urdf", arm.robot.tip, arm.joint_names, q, seen, model, folder)
        return rms(found.predict(test.q[judged]) - test.position[judged]), found.seconds


def chosen(rows: Measurements, name: str | None) -> Array:
    """Return which rows have a payload of that name; all where None."""
    return np.array([name is None or payload == name for payload in rows.payload])


def read_campaign(files: tuple[Path, Path, Path]) -> tuple[Arm, Measurements, Measurements]:
    """Return the declared arm, the rows to fit and those held out."""
    arm = armflex.load_arm(files[0])
    return arm, *(armflex.read_measurements(file, arm) for file in files[1:])


def compare(title: str, make: Callable[[int, Path], tuple[Path, Path, Path]]) -> None:
    """Print a line for everything that fits this kind of campaign: medians over the seeds, errors one by one."""
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as folder:
            campaign = read_campaign(make(seed, Path(folder)))
        for lines in (own_lines, figaroh_lines):
            for name, error, seconds in lines(*campaign):
                found.setdefault(name, []).append((error, seconds))
    print(f"\n{title} ({int(campaign[1].measured.sum())} rows fitted, {int(campaign[2].measured.sum())} held out)")
    print(f"{'held-out RMS, mm, by seed':>60} {'median':>7} {'s':>6} {'x armflex':>9}")
    own = np.median([seconds for _, seconds in found["armflex calibrate"]])
    for name, rows in found.items():
        errors, seconds = np.transpose(rows)
        each = " ".join(f"{error * 1e3:5.2f}" for error in errors)
        median, elapsed = np.median(errors) * 1e3, np.median(seconds)
        print(f"{name:>42} {each} {median:7.3f} {elapsed:6.2f} {elapsed / own:9.2f}")
    if figaroh_version() is None:
        print(f"{'FIGAROH':>42} not installed: pip install 'armflex[bench]'")


def main() -> None:
    warnings.simplefilter("ignore")
    print(f"{machine()}, figaroh {figaroh_version() or 'not installed'}")
    for title, make in CAMPAIGNS.items():
        compare(title, make)


if __name__ == "__main__":
    main()
