"""From a STEP file to the tip's sag: a link drawn as a solid, meshed by gmsh, condensed, and bent by what it carries.

Needs `pip install 'armflex[fem,step]'`. The STEP file is drawn here by gmsh, too; yours comes from CAD.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import armflex
from armflex.fem.condense import condense
from armflex.fem.part import write_part
from armflex.fem.read import read_mesh

LENGTH, WIDE, HIGH, WALL = 2.0, 0.20, 0.30, 0.02

ROBOT = f"""<robot name="jib"><link name="base"/>
<link name="boom"><inertial><origin xyz="{LENGTH / 2} 0 0"/><mass value="%g"/>
<inertia ixx="5" iyy="120" izz="120" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hook"/>
<joint name="luff" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="1e5" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="boom"/><child link="hook"/><origin xyz="{LENGTH} 0 0"/></joint></robot>"""

ARM = """[robot]
urdf = "jib.urdf"
tip = "hook"
gravity = [0.0, 0.0, -9.81]

[payload.load]
mass = 500.0
com = [0.0, 0.0, 0.0]

[link.boom]
file = "boom.toml"
"""


def draw(path: Path) -> None:
    """Write a box section as a STEP file."""
    import gmsh

    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    outer = gmsh.model.occ.addBox(0.0, -WIDE / 2, -HIGH / 2, LENGTH, WIDE, HIGH)
    inner = gmsh.model.occ.addBox(0.0, -WIDE / 2 + WALL, -HIGH / 2 + WALL, LENGTH, WIDE - 2 * WALL, HIGH - 2 * WALL)
    gmsh.model.occ.cut([(3, outer)], [(3, inner)])
    gmsh.model.occ.synchronize()
    gmsh.write(str(path))
    gmsh.finalize()


def main(folder: str | None = None) -> tuple[float, float]:
    """Return the tip's sag, and what a beam says of it [m]."""
    at = Path(folder or tempfile.mkdtemp())
    draw(at / "boom.step")
    mesh = read_mesh(at / "boom.step", young=2.1e11, poisson=0.3, density=7850.0, size=0.06)
    ends = {  # the faces of a STEP file are numbered: take those at the ends
        place: next(
            name
            for name, rows in mesh.sets.items()
            if name.startswith("face") and np.allclose(mesh.points[rows, 0], place, atol=1e-6)
        )
        for place in (0.0, LENGTH)
    }
    print(f"{len(mesh.points)} nodes; held at {ends[0.0]}, loaded at {ends[LENGTH]}")
    part = condense(mesh, ends[0.0], [ends[LENGTH]])
    write_part(part, at / "boom.toml")
    (at / "jib.urdf").write_text(ROBOT % part.mass)
    (at / "arm.toml").write_text(ARM)
    arm = armflex.load_arm(at / "arm.toml")
    sag = -arm.deflection(arm.position(), "load").displacement[2]

    second = (WIDE * HIGH**3 - (WIDE - 2 * WALL) * (HIGH - 2 * WALL) ** 3) / 12.0
    beam = (500.0 * LENGTH**3 / 3.0 + part.mass * LENGTH**3 / 8.0) * 9.81 / (2.1e11 * second)
    print(f"{part.mass:.0f} kg, first natural frequency {part.frequencies_hz[0]:.0f} Hz")
    print(f"the tip sags by {sag * 1e3:.3f} mm; a beam without shear says {beam * 1e3:.3f} mm")
    return float(sag), float(beam)


if __name__ == "__main__":
    main(*sys.argv[1:])
