"""How many of many new processes stand still: whatever uses threads, so many of each, some started at once.

    PYTHONPATH=tests python tests/studies/cold.py [-n 50] [--together 4] [--seconds 600]

Run it after a change to what is imported or compiled, or when: that two threads wait for each other for ever is seldom.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

from support.cold import COLD, cold_processes

from armflex.mechanics.many_rows import kernel_of_one_row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=50, help="processes of each kind")
    parser.add_argument("--together", type=int, default=4, help="processes started at once")
    parser.add_argument("--seconds", type=float, default=600.0, help="after which one stands still")
    asked = parser.parse_args()
    kernel_of_one_row()  # compiled and kept: what is counted is what stands still, and not what compiles
    ended = {name: Counter[str]() for name in COLD}
    with tempfile.TemporaryDirectory() as folder:
        names = [name for _ in range(asked.n) for name in COLD]
        for name, wrong in cold_processes(names, Path(folder), asked.together, asked.seconds):
            ended[name]["fine" if not wrong else "still" if wrong == "stands still" else "failed"] += 1
            if wrong:
                print(f"{name}: {wrong}", flush=True)
    print("| what | fine | stood still | failed |\n|---|---|---|---|")
    for name, counts in ended.items():
        print(f"| {name} | {counts['fine']} | {counts['still']} | {counts['failed']} |")
    if any(counts["fine"] < asked.n for counts in ended.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
