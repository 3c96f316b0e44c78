"""How commands grow with their rows: seconds of the processor and largest memory, each run in its own process.

    python tests/studies/scaling.py [predict check compensate calibrate] [--most 100000]
    python tests/studies/scaling.py trace [--most 5000] [--seed 1]

The rows of `predict` and `calibrate` are those of the bundled boom's campaign again and again, those of `check` and
`compensate` its path there and back, each a little different. All but `calibrate` ask an arm that was calibrated, so
that what was fitted is in every uncertainty. `trace` searches drawn campaigns of a boom that differs from what is
declared, with as many poses as rows, all different, and one effect or four that nobody declared; its errors are of
held-out poses, before and after. Seconds are those of the processor, user and system, which other work on the machine
changes little; where it has nothing else to do they are the time that passes.
"""

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaigns import draw

BOOM = Path(__file__).parents[2] / "robots" / "tarm_like"
STEPS = (1_000, 10_000, 100_000, 1_000_000)
CODE = "from armflex.cli.main import main; main()"
OPTIONS = {
    "predict": ("campaign.csv", ("-o", "out.csv")),
    "check": ("trajectory.csv", ("--tolerance", "50mm")),
    "compensate": ("trajectory.csv", ("-o", "out.csv", "--best-effort")),
    "calibrate": ("campaign.csv", ("-o", "out.toml")),
}
TRACED = ("backlash", "4 effects")
POSES = (312, 1_500, 5_000)


def write_rows(source: Path, path: Path, count: int) -> Path:
    """Write so many rows like those of a table, with joint positions and readings a little different each time."""
    with source.open() as file:
        rows = list(csv.DictReader(file))
    rng, longest = np.random.default_rng(1), max(float(row["time"]) for row in rows) + 1.0
    if "via" in rows[0]:
        rows, longest = rows + rows[-2:0:-1], 0.0  # there and back: a path has no jumps
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(rows[0])
        for i in range(count):
            row = dict(rows[i % len(rows)])
            row["time"] = repr(float(row["time"]) + i // len(rows) * longest if longest else float(i))
            for name in row:
                if name.startswith("q_"):
                    row[name] = repr(
                        float(row[name]) * (1.0 - 1e-4 * rng.random()) if longest == 0.0 else float(row[name])
                    )
                elif name in ("x", "y", "z") and row[name]:
                    row[name] = repr(float(row[name]) + 1e-4 * rng.standard_normal())
            writer.writerow(row.values())
    return path


def run(folder: Path, command: str, arm: Path, table: Path, options: Sequence[str]) -> tuple[float, float]:
    """Return the seconds of the processor and the largest memory [MB] that a command takes."""
    package = os.environ | {"PYTHONPATH": str(BOOM.parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, command, str(arm), str(table), *options],
        cwd=folder,
        env=package,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    said = process.stderr.read().decode()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1) or "error:" in said:
        raise SystemExit(f"{command} {table.name}: {said}")
    unit = 1 if sys.platform == "darwin" else 1024
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6


def repeated(folder: Path, commands: Sequence[str], most: int) -> None:
    """Print what commands take of more and more rows like those of the bundled boom."""
    print("| command | rows | s | MB | µs a row | bytes a row |\n|---|---|---|---|---|---|")
    declared, calibrated = BOOM / "measured.toml", folder / "calibrated.toml"
    run(folder, "calibrate", declared, BOOM / "campaign.csv", ("-o", str(calibrated)))
    for command in commands:
        source, options = OPTIONS[command]
        arm, before = declared if command == "calibrate" else calibrated, None
        for count in (step for step in STEPS if step <= most):
            table = write_rows(BOOM / source, folder / f"{command}.csv", count)
            seconds, size = run(folder, command, arm, table, options)
            each = "| - | - |"
            if before:
                more = count - before[0]
                each = f"| {(seconds - before[1]) / more * 1e6:.0f} | {(size - before[2]) / more * 1e6:.0f} |"
            print(f"| {command} | {count} | {seconds:.1f} | {size:.0f} {each}", flush=True)
            before = count, seconds, size


def traced(folder: Path, most: int, seed: int) -> None:
    """Print what `trace` takes of campaigns of more and more poses, and how well poses are predicted afterwards."""
    print("| hidden | poses | s | MB | calibrated, held out [mm] | traced, held out [mm] |\n|---|---|---|---|---|---|")
    for kind in TRACED:
        for count in (count for count in POSES if count <= most):
            truth = draw(kind, seed, "boom", poses=count).write(folder / f"{kind}-{count}")
            seconds, size = run(folder, "trace", truth.arm, truth.train, ("-o", "out.toml", "--json", "out.json"))
            errors = json.loads((folder / "out.json").read_text())["held_out_rms_mm"]
            held_out = f"{errors['calibrated']:.3f} | {errors['after']:.3f}"
            print(f"| {kind} | {count} | {seconds:.1f} | {size:.0f} | {held_out} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", default=["predict", "check", "compensate"], metavar="COMMAND")
    parser.add_argument("--most", type=int, default=100_000, help="rows at most")
    parser.add_argument("--seed", type=int, default=1, help="of the campaigns that are traced")
    asked = parser.parse_args()
    if unknown := [name for name in asked.commands if name not in (*OPTIONS, "trace")]:
        parser.error(f"{', '.join(unknown)}: expected some of {', '.join((*OPTIONS, 'trace'))}")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as name:
        if rest := [command for command in asked.commands if command != "trace"]:
            repeated(Path(name), rest, asked.most)
        if "trace" in asked.commands:
            traced(Path(name), asked.most, asked.seed)


if __name__ == "__main__":
    main()
