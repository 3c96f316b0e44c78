"""heavy_six with payloads and a prior of a test's own."""

from pathlib import Path

import numpy as np

from armflex import load_arm
from support.small_arms import ROBOTS

PAYLOADS = (("empty", 0.0, (0, 0, 0)), ("p100", 100.0, (0.1, 0.0, 0.0)), ("p200", 200.0, (0.1, 0.0, 0.0)))


def declared(folder: Path, prior: str) -> Path:
    """Write heavy_six with payloads and a prior of our own; J2's full matrix becomes its diagonal."""
    text = (ROBOTS / "heavy_six" / "arm.toml").read_text()
    head, flexures = text.partition("[flexure.J1]")[0].partition("[payload")[0], []
    for name in ("J1", "J2", "J3", "J4", "J5", "J6"):
        part = text.partition(f"[flexure.{name}]")[2].partition("\n[")[0]
        law = load_arm(ROBOTS / "heavy_six" / "arm.toml").flexures[int(name[1]) - 1].law
        diagonal = [float(x) for x in np.diag(law.compliance)]
        assert part
        flexures.append(f'[flexure.{name}]\njoint = "{name}"\nmodel = "linear"\ncompliance = {diagonal}\n')
    loads = "".join(f"[payload.{n}]\nmass = {m}\ncom = {list(map(float, c))}\n" for n, m, c in PAYLOADS)
    head = head.replace('"robot.urdf"', f'"{(ROBOTS / "heavy_six" / "robot.urdf").as_posix()}"')
    file = folder / "arm.toml"
    file.write_text(f'{head}\n{loads}\n{"".join(flexures)}\n[measurement]\nframe = "unknown"\n[prior]\n{prior}\n')
    return file
