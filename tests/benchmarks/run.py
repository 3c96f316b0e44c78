"""All benchmarks one after the other, printed as they go and written to one file: `make bench`.

    python tests/benchmarks/run.py -o bench.md [NAME ...]

A benchmark is a script in this folder that can be run; each prints what its figures are ratios of, and says so where a
peer that it would compare with is not installed. One that fails is named, and the others still run.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine

HERE = Path(__file__).parent
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}


def scripts() -> dict[str, Path]:
    """Return the benchmarks by name."""
    found = (path for path in sorted(HERE.glob("*.py")) if path.name != Path(__file__).name)
    return {path.stem: path for path in found if "__main__" in path.read_text()}


def run(path: Path) -> tuple[str, int]:
    """Return what a benchmark prints, printed meanwhile, and its exit code."""
    command, settings = [sys.executable, "-u", str(path)], {**os.environ, **ONE_THREAD}
    lines = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=settings
    ) as program:
        for line in program.stdout:
            print(line, end="", flush=True)
            lines.append(line)
    return "".join(lines), program.returncode


def section(path: Path) -> tuple[str, bool]:
    """Return a benchmark's part of the file, and whether it ran to its end."""
    print(f"\n=== {path.stem}", flush=True)
    begun = time.perf_counter()
    text, code = run(path)
    ended = f"{time.perf_counter() - begun:.0f} s" if code == 0 else f"failed with exit code {code}"
    summary = path.read_text().partition('"""')[2].partition("\n")[0].removesuffix('"""')
    return f"## {path.stem}\n\n{summary} ({ended})\n\n```text\n{text.rstrip()}\n```\n", code == 0


def main() -> None:
    known = scripts()
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; all where none is given")
    parser.add_argument("-o", "--output", type=Path, default=Path("bench.md"))
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in known]
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r} (known: {', '.join(known)})")
    parts = [section(known[name]) for name in given.names or known]
    head = f"# Benchmarks\n\n{machine()}. Every figure is of one run on one machine: read the ratios.\n"
    given.output.write_text("\n".join([head, *(text for text, _ in parts)]))
    print(f"\nWritten to {given.output}.")
    if not all(fine for _, fine in parts):
        sys.exit(1)


if __name__ == "__main__":
    main()
