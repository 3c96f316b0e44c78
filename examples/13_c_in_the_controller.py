"""The boom goes into its controller: exported as C, compiled, and asked the same as armflex.

The controller's part is `CONTROLLER`: it reads joint positions and a payload's number from its input, one row after the
other, and prints where the flexed tip is, and the joint positions that bring it to where the rigid arm would be.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import armflex
from armflex.export.c_code import export

ROWS = 200

CONTROLLER = """
#include <stdio.h>

extern const int boom_nq;
int boom_tip(const double *q, int payload, double *pose);
int boom_compensate(const double *q, int payload, double *out);

int main(void)
{
    double q[16], out[16], pose[12];
    int payload = 0;
    while (scanf("%d", &payload) == 1) {
        for (int j = 0; j < boom_nq; j++) {
            if (scanf("%lf", &q[j]) != 1) {
                return 1;
            }
        }
        if ((boom_tip(q, payload, pose) != 0) || (boom_compensate(q, payload, out) != 0)) {
            return 2;
        }
        printf("%.17g %.17g %.17g", pose[3], pose[7], pose[11]);
        for (int j = 0; j < boom_nq; j++) {
            printf(" %.17g", out[j]);
        }
        printf("\\n");
    }
    return 0;
}
"""


def main(folder: str = "") -> tuple[float, float] | None:
    """Return how far [m] C and armflex have the tip apart, and how far the compensated tip is from its goal."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        print("there is no C compiler here")
        return None
    place = Path(folder or tempfile.mkdtemp())
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
    found = export(arm, "boom")  # as `armflex export arm.toml --to c -o boom.c --name boom`
    (place / "boom.c").write_text(found.text)
    (place / "controller.c").write_text(CONTROLLER)
    program = place / "controller"
    subprocess.run(
        [compiler, "-std=c99", "-O2", "-o", program, "controller.c", "boom.c", "-lm"],
        cwd=place,
        check=True,
        timeout=600,
    )

    q = np.random.default_rng(1).uniform(0.5 * arm.robot.lower, 0.5 * arm.robot.upper, (ROWS, len(arm.joint_names)))
    payload = found.numbers["payloads"].index("p600")
    rows = "".join(f"{payload} {' '.join(map(repr, row))}\n" for row in q.tolist())
    said = subprocess.run([program], input=rows, capture_output=True, text=True, check=True, timeout=600).stdout
    answers = np.array([line.split() for line in said.splitlines()], dtype=float)

    tips = arm.deflection(q, "p600").pose[:, :3, 3]
    apart = float(np.abs(answers[:, :3] - tips).max())
    driven = arm.deflection(answers[:, 3:], "p600").pose[:, :3, 3]
    goal = np.array([arm.rigid_pose(row).translation for row in q])
    left = float(np.abs(driven - goal).max())
    sag = float(np.linalg.norm(tips - goal, axis=1).max())
    print(
        f"{ROWS} poses with 600 kg: the tip sags up to {sag * 1e3:.0f} mm; C and armflex have it alike to {apart:.1g} m"
    )
    print(f"at the joint positions that C compensates with it is where the rigid arm would be, to {left:.1g} m")
    return apart, left


if __name__ == "__main__":
    main(*sys.argv[1:])
