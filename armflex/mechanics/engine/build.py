"""Compile engine.c for this machine: by its own compiler, or by zig's, which is a package.

On x86-64 there are three libraries, of which the fastest is loaded that the processor can run: with AVX2, and with
AVX-512 eight rows side by side. Their names carry a digest of all that they are made of, so that one of another text is
never loaded.
`python -m armflex.mechanics.engine.build` puts them beside the sources; a wheel has them there, an editable
installation in a folder of its own.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

FOLDER = Path(__file__).parent
SOURCES = ("engine.c", "rest.h", "engine.h")
BESIDE = "_armflex_engine"
"""Folder of an editable installation's libraries, among the installed packages."""

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LEVELS = ("baseline", "v3", "v4")
"""Of x86-64, by what `engine_level` returns; others have the first."""

FLAGS = ("-std=gnu99", "-O3", "-fno-tree-slp-vectorize", "-shared", "-Wno-psabi", "-fno-strict-aliasing")
"""Not -ffast-math: in a shared library gcc's turns denormals off for the whole process. Packs are written where they
pay: of straight code gcc makes some that cost a sixth of a response's time."""

WANTED = "armflex compiles its engine, and needs a C compiler: install gcc or clang, or `pip install ziglang`"


def digest() -> str:
    """Return what the names of the libraries carry: 16 digits of their sources and flags."""
    found = hashlib.sha256(" ".join(FLAGS).encode())
    for name in SOURCES:
        found.update((FOLDER / name).read_bytes().replace(b"\r\n", b"\n"))
    return found.hexdigest()[:16]


def library_name(level: str) -> str:
    """Return the file name of a library."""
    return f"engine-{digest()}-{level}{SUFFIX}"


def on_x86_64() -> bool:
    """Return whether there are two levels of instructions."""
    return platform.machine().lower() in ("x86_64", "amd64")


def own_compiler() -> list[str]:
    """Return the command of the machine's C compiler, empty where there is none."""
    known = os.environ.get("CC") or next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), "")
    return known.split()


def compile_engine(into: Path) -> list[Path]:
    """Compile the engine into a folder and return its libraries; raise `SystemExit` that says what to install."""
    compiler, zig = own_compiler(), False
    if not compiler:
        if find_spec("ziglang") is None:
            raise SystemExit(WANTED)
        compiler, zig = [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=all"], True
    libraries = []
    for level in LEVELS if on_x86_64() else LEVELS[:1]:
        march = [] if level == LEVELS[0] else [f"-mcpu=x86_64_{level}" if zig else f"-march=x86-64-{level}"]
        link = [] if sys.platform == "win32" else ["-fPIC", "-lm"]
        library = into / library_name(level)
        part = library.with_name(f"{library.stem}.{os.getpid()}{SUFFIX}")  # two builds may be at it
        command = [*compiler, *FLAGS, *march, str(FOLDER / SOURCES[0]), "-o", str(part), *link]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        except OSError as error:
            raise SystemExit(f"{WANTED}\n{command[0]}: {error}") from None
        if done.returncode:
            raise SystemExit(f"engine.c does not compile:\n{' '.join(command)}\n{done.stdout}{done.stderr}\n{WANTED}")
        os.replace(part, library)
        libraries.append(library)
    return libraries


if __name__ == "__main__":
    for old in FOLDER.glob("engine-*-*.*"):
        old.unlink()
    for made in compile_engine(FOLDER):
        print(made)
