"""Exported C beside `arm.prepared` in the same run: the tip, and the joint positions that compensate, per row.

`gcc -std=c99 -O2`; both get rows of random positions. Goals of the C: 10 us for the tip, 100 us to compensate.

OPENBLAS_NUM_THREADS=1 python tests/benchmarks/export_c.py
"""

import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from baseline import machine, medians_us
from boom import make_boom
from query import KNOWN, arms

import armflex
from armflex import Arm
from armflex.export.c_code import export

ROWS = 100
LOOPS = """
int many_tips(const double *q, int payload, double *out)
{
    int refused = 0;
    for (int i = 0; i < %(rows)d; i++) {
        refused += (arm_tip(&q[%(joints)d * i], payload, out) != 0) ? 1 : 0;
    }
    return refused;
}
int many_compensated(const double *q, int payload, double *out)
{
    int refused = 0;
    for (int i = 0; i < %(rows)d; i++) {
        refused += (arm_compensate(&q[%(joints)d * i], payload, out) != 0) ? 1 : 0;
    }
    return refused;
}
"""


def compiled(arm: Arm, folder: Path, name: str) -> tuple[ctypes.CDLL, dict[str, float]]:
    """Return the library of an arm with loops over many rows, and the covariates that it was given."""
    found = export(arm)
    source, made = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(found.text + LOOPS % {"rows": ROWS, "joints": len(arm.joint_names)})
    subprocess.run(["gcc", "-std=c99", "-O2", "-fPIC", "-shared", "-o", made, source, "-lm"], check=True, timeout=600)
    library, names = ctypes.CDLL(str(made)), found.numbers["covariates"]
    values = (ctypes.c_double * max(1, len(names))).in_dll(library, "arm_covariates")
    for i, one in enumerate(names):
        values[i] = KNOWN[one]
    return library, {one: KNOWN[one] for one in names}


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        boom = make_boom(folder, drives_only=False, sag=0.03)
        known = {
            name: armflex.load_arm(armflex.bundled_robot(name) / "arm.toml") for name in ("tarm_like", "heavy_six")
        }
        known |= {f"boom, {name}": arm for name, arm in arms(boom).items()}
        print(f"{'arm':>20} {'prepared us':>12} {'tip us':>8} {'of prepared':>12} {'compensate us':>14} {'refused':>8}")
        for number, (name, arm) in enumerate(known.items()):
            library, covariates = compiled(arm, folder, f"arm{number}")
            lower, upper = np.maximum(arm.robot.lower, -2.0), np.minimum(arm.robot.upper, 2.0)
            q = np.random.default_rng(0).uniform(lower, upper, (ROWS, len(lower)))
            loop, out = arm.prepared(), np.empty(64)
            pointers = [array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in (q, out)]
            calls: dict[str, Callable[[], object]] = {
                "prepared": lambda loop=loop, q=q, known=covariates: [loop(row, **known) for row in q],
                "tip": lambda ask=library.many_tips, given=pointers: ask(given[0], 0, given[1]),
                "compensate": lambda ask=library.many_compensated, given=pointers: ask(given[0], 0, given[1]),
            }
            times = medians_us(calls, rounds=15, repeats=None, clock=time.process_time)
            prepared, tip, compensate = (times[one] / ROWS for one in ("prepared", "tip", "compensate"))
            refused = f"{calls['compensate']()} of {ROWS}"
            print(f"{name:>20} {prepared:12.1f} {tip:8.2f} {tip / prepared:12.2f} {compensate:14.1f} {refused:>8}")


if __name__ == "__main__":
    main()
