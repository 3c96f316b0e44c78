"""What it costs to start: `import armflex` and `armflex --help` beside `import pinocchio`, wall time, and who takes it.

    python tests/benchmarks/startup.py

Every start is a new process; the commands take turns; medians, and the quickest. Other programs lengthen the wall time
but hardly the processor's. Aims: 0.5 s of wall time for the import, 0.7 s for the help.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine

ROUNDS = 15
SCRIPT = str(Path(sys.executable).parent / "armflex")
COMMANDS = {
    "python -c pass": ["-c", "pass"],
    'python -c "import numpy"': ["-c", "import numpy"],
    'python -c "import pinocchio"': ["-c", "import pinocchio"],
    'python -c "import armflex"': ["-c", "import armflex"],
    "armflex --help": [SCRIPT, "--help"],
    "armflex deflect --help": [SCRIPT, "deflect", "--help"],
    "armflex trace --help": [SCRIPT, "trace", "--help"],
}
BASELINE = 'python -c "import pinocchio"'
HEAVY = ("torch", "matplotlib", "jinja2", "arviz", "arviz_stats", "scipy", "rich", "pandas", "joblib")
SHOWN = 12


def elapsed(arguments: list[str]) -> tuple[float, float]:
    """Return the wall time of a new Python, and the processor's [s]."""
    before, start = used(), time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, timeout=600)
    return time.perf_counter() - start, used() - before


def used() -> float:
    """Return the processor's time in the processes that this one started and that ended [s]."""
    times = os.times()
    return times.children_user + times.children_system


def times() -> None:
    """Print the median start of every command, and the quickest."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in COMMANDS}
    for _ in range(ROUNDS):
        for name, arguments in COMMANDS.items():
            found[name].append(elapsed(arguments))
    base = np.median(found[BASELINE], axis=0)[0]
    print(f"{'start':>30} {'wall s':>8} {'least':>8} {'CPU s':>8} {'x import pinocchio':>19}")
    for name, seconds in found.items():
        (wall, processor), least = np.median(seconds, axis=0), min(seconds)[0]
        print(f"{name:>30} {wall:8.3f} {least:8.3f} {processor:8.3f} {wall / base:19.2f}")


def imported(arguments: list[str]) -> dict[str, float]:
    """Return the modules that a command imports and the time each takes itself [s]."""
    run = [sys.executable, "-X", "importtime", *arguments]
    text = subprocess.run(run, check=True, capture_output=True, text=True, timeout=600).stderr
    found = {}
    for line in text.splitlines():
        own, _, name = line.removeprefix("import time:").split("|")
        if own.strip().isdigit():
            found[name.strip()] = int(own) * 1e-6
    return found


def who(name: str) -> None:
    """Print which packages take the time of a command's imports, and which heavy ones it imports."""
    modules, packages = imported(COMMANDS[name]), {}
    for module, seconds in modules.items():
        package = module.split(".")[0]
        packages[package] = packages.get(package, 0.0) + seconds
    slowest = sorted(packages.items(), key=lambda pair: -pair[1])[:SHOWN]
    print(f"\n{name}, {len(modules)} modules, by package (ms, slower than without the tracing):")
    print(", ".join(f"{package} {seconds * 1e3:.0f}" for package, seconds in slowest))
    print("of " + ", ".join(HEAVY) + ": " + (", ".join(package for package in HEAVY if package in packages) or "none"))


def main() -> None:
    print(f"{machine()}, load {os.getloadavg()[0]:.1f} at the start")
    times()
    for name in ('python -c "import armflex"', "armflex --help", "armflex deflect --help"):
        who(name)


if __name__ == "__main__":
    main()
