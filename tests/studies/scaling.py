"""How commands grow with their rows: seconds of the processor and largest memory, from a thousand rows up.

    python tests/studies/scaling.py [predict check compensate calibrate trace] [--most 100000]

The rows are those of the bundled boom again and again, each a little different: a campaign's for `predict`, `calibrate`
and `trace`, the path there and back for `check` and `compensate`. All but `calibrate` and `trace` ask an arm that was
calibrated, so that what was fitted is in every uncertainty. Seconds are those of the processor, which other work on the
machine changes little; where it has nothing else to do they are the time that passes.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

BOOM = Path(__file__).parents[2] / "robots" / "tarm_like"
STEPS = (1_000, 10_000, 100_000, 1_000_000)
CODE = "from armflex.cli.main import main; main()"
OPTIONS = {
    "predict": ("campaign.csv", ("-o", "out.csv")),
    "check": ("trajectory.csv", ("--tolerance", "50mm")),
    "compensate": ("trajectory.csv", ("-o", "out.csv", "--best-effort")),
    "calibrate": ("campaign.csv", ("-o", "out.toml")),
    "trace": ("campaign.csv", ("-o", "out.toml")),
}


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commands", nargs="*", default=["predict", "check", "compensate"], metavar="COMMAND")
    parser.add_argument("--most", type=int, default=100_000, help="rows at most")
    asked = parser.parse_args()
    if unknown := [name for name in asked.commands if name not in OPTIONS]:
        parser.error(f"{', '.join(unknown)}: expected some of {', '.join(OPTIONS)}")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print("| command | rows | s | MB | µs a row | bytes a row |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        declared, calibrated = BOOM / "measured.toml", folder / "calibrated.toml"
        run(folder, "calibrate", declared, BOOM / "campaign.csv", ("-o", str(calibrated)))
        for command in asked.commands:
            source, options = OPTIONS[command]
            arm, before = declared if command in ("calibrate", "trace") else calibrated, None
            for count in (step for step in STEPS if step <= asked.most):
                table = write_rows(BOOM / source, folder / f"{command}.csv", count)
                seconds, size = run(folder, command, arm, table, options)
                each = "| - | - |"
                if before:
                    more = count - before[0]
                    each = f"| {(seconds - before[1]) / more * 1e6:.0f} | {(size - before[2]) / more * 1e6:.0f} |"
                print(f"| {command} | {count} | {seconds:.1f} | {size:.0f} {each}", flush=True)
                before = count, seconds, size


if __name__ == "__main__":
    main()
