"""What an installed wheel must answer: one question to the engine, and the same to Pinocchio. Needs no test package."""

import sys
from pathlib import Path

import numpy as np

import armflex
from armflex.mechanics.engine import build

arm = armflex.load_arm(armflex.bundled_robot("heavy_six") / "arm.toml")
loops = armflex.load_arm(armflex.bundled_robot("palletizer") / "arm.toml")
libraries = sorted(path.name for path in build.FOLDER.glob(f"engine-{build.digest()}-*"))
assert len(libraries) == (len(build.LEVELS) if build.on_x86_64() else 1), libraries
for one in (arm, loops):
    q = np.tile(one.position(), (9, 1))
    many, reference = one.deflection(q), one.deflection(q[0], method="newton")
    np.testing.assert_allclose(many.displacement, np.tile(reference.displacement, (9, 1)), rtol=0, atol=1e-12)
assert Path(__file__).parents[2] not in Path(armflex.__file__).parents, "the checkout was asked"
print(sys.platform, armflex.__version__, libraries)
