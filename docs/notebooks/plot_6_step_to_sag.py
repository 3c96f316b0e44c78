"""
From a STEP file to the tip's sag
=================================

A link drawn as a solid is meshed, condensed to what an arm needs of it, and bent by its own weight and by what it
carries. It needs ``pip install 'armflex[fem,step]'`` and the libraries that gmsh asks of the system. Where gmsh cannot
be loaded, this page says so and continues with a deck of the same section, whose 240 bricks are written below.
"""

# %%
# The STEP file
# -------------
#
# Yours comes from CAD. Here ``examples/17_step_to_sag.py`` draws a box section of 2 m by gmsh.
import sys
from importlib import import_module
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import armflex
from armflex.fem.condense import condense
from armflex.fem.part import write_part
from armflex.fem.read import read_mesh

for home in (Path.cwd(), *Path.cwd().parents):
    if (home / "examples" / "17_step_to_sag.py").is_file():
        sys.path.insert(0, str(home / "examples"))
        break
drawn, folder = import_module("17_step_to_sag"), Path(mkdtemp())


def write_deck(path: Path) -> None:
    """Write the same section as an Abaqus deck: bricks of twenty nodes, one across the wall."""
    half = np.array([[drawn.WIDE], [drawn.HIGH]]) / 2
    y, z = half * [-1, -1, 0, 1, 1] + drawn.WALL * np.array([0, 1, 0, -1, 0])
    corner_lines = (np.linspace(0, drawn.LENGTH, 21), y, z)
    lines = [np.insert(at, range(1, len(at)), (at[1:] + at[:-1]) / 2) for at in corner_lines]
    corners = 2 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
    twenty = np.vstack([corners, corners[edges].mean(axis=1).astype(int)])
    wall = [at for at in product(range(20), range(4), range(4)) if at[1] in (0, 3) or at[2] in (0, 3)]
    bricks = [[tuple(2 * np.array(at) + step) for step in twenty] for at in wall]
    number = {at: i + 1 for i, at in enumerate(sorted({at for brick in bricks for at in brick}))}
    nodes = [f"{i}, " + ", ".join(str(line[k]) for line, k in zip(lines, at, strict=True)) for at, i in number.items()]
    rows = [[i + 1, *(number[at] for at in brick)] for i, brick in enumerate(bricks)]
    elements = [", ".join(map(str, row[:11])) + ",\n" + ", ".join(map(str, row[11:])) for row in rows]
    ends = {name: [str(i) for at, i in number.items() if at[0] == end] for name, end in (("ROOT", 0), ("TIP", 40))}
    sets = [f"*NSET, NSET={name}\n" + ",\n".join(rows) for name, rows in ends.items()]
    path.write_text("\n".join(["*NODE", *nodes, "*ELEMENT, TYPE=C3D20, ELSET=BOOM", *elements, *sets]) + "\n")


try:
    source = folder / "boom.step"
    drawn.draw(source)
except (ImportError, OSError) as error:
    print(f"gmsh cannot be loaded ({error}): the deck stands for the STEP file")
    source = folder / "boom.inp"
    write_deck(source)

# %%
# The mesh
# --------
#
# gmsh meshes it into tetrahedra of ten nodes. The faces of the solid are sets; the two at the ends are where the link
# joins its neighbours. A STEP file names no material.
mesh = read_mesh(source, young=2.1e11, poisson=0.3, density=7850.0, size=0.12 if source.suffix == ".step" else None)
faces = {name: mesh.points[rows] for name, rows in mesh.sets.items()}
root, tip = (next(n for n, p in faces.items() if np.allclose(p[:, 0], x, atol=1e-6)) for x in (0.0, drawn.LENGTH))
print(f"{len(mesh.points)} nodes; held at {root}, loaded at {tip}")
fig, ax = plt.subplots(figsize=(7, 3.4), subplot_kw={"projection": "3d"}, layout="constrained")
ax.scatter(*mesh.points.T, s=1, color="#9fb4c8")
for name, color in ((root, "#2e9e4f"), (tip, "#d7263d")):
    ax.scatter(*faces[name].T, s=4, color=color)
ax.set(box_aspect=np.ptp(mesh.points, axis=0), xlabel="x [m]")

# %%
# The part
# --------
#
# It is condensed onto the loaded face: compliance, mass, weight and natural frequencies. The command is
# ``armflex fem boom.step --fixed face_1 --loaded face_10 --size 120mm --young 2.1e11 --poisson 0.3 --density 7850
# -o boom.toml``.
part = condense(mesh, root, [tip])
write_part(part, folder / "boom.toml")
print(f"{part.mass:.0f} kg; held at its root it swings at", part.frequencies_hz.round(0)[:3], "Hz")
own = np.linalg.norm(part.sag(np.array([0.0, 0.0, -9.81]))[:3])
print(f"held level by its root it sags by {own * 1e3:.3f} mm under its own weight")

# %%
# The arm
# -------
#
# ``[link.boom]`` makes it a link of an arm that luffs and carries 500 kg.
(folder / "jib.urdf").write_text(drawn.ROBOT % part.mass)
(folder / "arm.toml").write_text(drawn.ARM)
arm = armflex.load_arm(folder / "arm.toml")
luff = np.linspace(-1.4, 1.4, 29)
fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for payload in ("none", "load"):
    sag = [-1e3 * arm.deflection(arm.position(luff=-q), payload).displacement[2] for q in luff]
    ax.plot(np.rad2deg(luff), sag, label={"none": "empty", "load": "500 kg"}[payload])
ax.set(xlabel="luffing angle [deg]", ylabel="the tip's sag [mm]")
ax.legend(frameon=False)
loaded = arm.deflection(arm.position(), "load"), arm.modes(arm.position(), "load")
print(f"level, with 500 kg: {-1e3 * loaded[0].displacement[2]:.3f} mm; it swings at {loaded[1].frequencies[0]:.1f} Hz")

# %%
# A beam without shear has 0.351 mm of it. A mesh has neither welds nor bolts: ``young = 0.1`` in ``[prior]`` lets
# ``armflex calibrate`` find one factor for the part from readings of the tip.

# %%
# Drawn
# -----
#
# The page has the mesh itself, bent, with its deflection magnified. Drag it.
armflex.view(arm, arm.position(luff=-0.4), "load")
