"""The engine under AddressSanitizer and UBSan: no table that its checks let pass makes it leave its memory."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from armflex.mechanics.engine import build

COUNT = 10_000 if os.environ.get("HYPOTHESIS_PROFILE") == "fuzz" else 300
HERE = Path(__file__).parent
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-fno-omit-frame-pointer")


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux") or shutil.which("gcc") is None, reason="needs gcc's sanitizers"
)
def test_damaged_tables_are_refused_or_answered(tmp_path: Path) -> None:
    library = tmp_path / "engine.so"
    flags = ["-std=gnu99", "-O0", "-g1", "-Wno-psabi", "-fPIC", "-shared", *SANITIZED]
    source = build.FOLDER / build.SOURCES[0]
    subprocess.run(["gcc", *flags, str(source), "-o", str(library), "-lm"], check=True, timeout=600)
    found = [
        subprocess.run(["gcc", f"-print-file-name={name}"], check=True, capture_output=True, text=True, timeout=60)
        for name in ("libasan.so", "libstdc++.so")  # Pinocchio's exceptions need the second
    ]
    given = os.environ | {
        "LD_PRELOAD": " ".join(one.stdout.strip() for one in found),
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "PYTHONPATH": os.pathsep.join([str(HERE.parent), str(HERE.parents[1])]),
    }
    asked = [sys.executable, str(HERE / "damaged_tables.py"), str(library), str(COUNT), "1"]
    done = subprocess.run(asked, env=given, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stderr[-4000:]
    refused = int(done.stdout.split()[0])
    assert 0 < refused < COUNT
