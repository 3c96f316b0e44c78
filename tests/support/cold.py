"""New processes whose threads need the compiled engine at once: what each runs, and which of them stand still."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from support.small_arms import ROBOTS

COMMAND = """
import sys
from armflex.mechanics import many_rows, response
many_rows.LOADED_AFTER = many_rows.COMPILED_AFTER = 0
response.AT_ONCE = 20
from armflex.tasks import check, compensate, predict
predict.TOGETHER = check.TOGETHER = compensate.TOGETHER = 5
from armflex.cli.main import main
main()
"""
"""A command whose pieces are so small that the bundled tables have many, and whose first row needs the engine."""

BATCH = """
import numpy as np, armflex
from armflex.mechanics import deflection, many_rows
many_rows.LOADED_AFTER = many_rows.COMPILED_AFTER = 0
deflection.PIECE = 5
arm = armflex.load_arm("{arm}")
arm.deflection(np.zeros((50, 7)), "p300", jobs=4)
"""

THREADS = """
import threading
import numpy as np, armflex
from armflex.mechanics import many_rows
many_rows.LOADED_AFTER = many_rows.COMPILED_AFTER = 0
arm, start, done = armflex.load_arm("{arm}"), threading.Barrier(4), []
def ask(i):
    start.wait()
    loop = arm.prepared("p300") if i % 2 else None
    found = loop(np.zeros(7)) if loop else arm.deflection(np.zeros((5, 7)), "p300").displacement[0]
    done.append(found)
threads = [threading.Thread(target=ask, args=(i,)) for i in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert np.ptp(done, axis=0).max() < 1e-12, done
"""
"""Threads of somebody's own, of which each is the first to ask."""

ARM, PATH, ROWS = (ROBOTS / "tarm_like" / name for name in ("arm.toml", "trajectory.csv", "campaign.csv"))

COLD: dict[str, tuple[str, ...]] = {
    "predict": (COMMAND, "predict", str(ARM), str(ROWS), "-o", "predicted-{number}.csv"),
    "check": (COMMAND, "check", str(ARM), str(PATH), "--tolerance", "1m"),
    "compensate": (COMMAND, "compensate", str(ARM), str(PATH), "-o", "compensated-{number}.csv"),
    "map": (COMMAND, "map", str(ARM), "-o", "map-{number}.csv", "--rows", "16", "--jobs", "2"),
    "calibrate": (COMMAND, "calibrate", str(ARM), "some.csv", "-o", "calibrated-{number}.toml"),
    "a batch in threads": (BATCH.format(arm=ARM.as_posix()),),
    "threads of one's own": (THREADS.format(arm=ARM.as_posix()),),
}


def cold_processes(names: Iterable[str], folder: Path, together: int, seconds: float) -> Iterator[tuple[str, str]]:
    """Yield each process of these names, and what is wrong with how it ended: nothing, or how; so many run at a time.

    Args:
        names: Of `COLD`, one for each process.
        folder: Where they write.
        together: How many are started at once.
        seconds: After which one stands still, and is ended.
    """
    (folder / "some.csv").write_text("".join(ROWS.open().readlines()[:60]))
    waiting = list(enumerate(names))
    while waiting:
        batch, waiting = waiting[:together], waiting[together:]
        until, running = time.monotonic() + seconds, []
        for number, name in batch:
            command = [sys.executable, "-c", *(part.replace("{number}", str(number)) for part in COLD[name])]
            env = os.environ | {"PYTHONPATH": str(ROBOTS.parent)}
            pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
            begun = subprocess.Popen(command, cwd=folder, env=env, text=True, start_new_session=True, **pipes)
            running.append((name, begun))
        for name, process in running:
            try:
                said = process.communicate(timeout=max(until - time.monotonic(), 1.0))[1]
                yield name, said if process.returncode else ""
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)  # its own processes hold its pipe
                process.communicate()
                yield name, "stands still"
