"""Logs of controllers and exports of trackers of one campaign, as their programs write them."""

from pathlib import Path

import numpy as np

Q = np.random.default_rng(1).uniform(-150.0, 150.0, (6, 6)).round(4)
XYZ = np.random.default_rng(2).uniform(-1500.0, 1500.0, (6, 3)).round(3)
NAMES = [f"P{i + 1:03d}" for i in range(6)]


def comma(value: float) -> str:
    return f"{value:.3f}".replace(".", ",")


LOGS = {
    "degrees": "Point,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n"
    + "\n".join(f"{name},{','.join(map(str, q))}" for name, q in zip(NAMES, Q, strict=True)),
    "names called otherwise": "Nr,J1 [deg],J2 [deg],J3 [deg],J4 [deg],J5 [deg],J6 [deg]\n"
    + "\n".join(f"{name},{','.join(map(str, q))}" for name, q in zip(NAMES, Q, strict=True)),
    "kuka": "$AXIS_ACT.A1;$AXIS_ACT.A2;$AXIS_ACT.A3;$AXIS_ACT.A4;$AXIS_ACT.A5;$AXIS_ACT.A6;Name\n"
    + "\n".join(f"{';'.join(f'{v:.4f}'.replace('.', ',') for v in q)};{n}" for n, q in zip(NAMES, Q, strict=True)),
    "ur": "timestamp "
    + " ".join(f"actual_q_{i}" for i in range(6))
    + "\n"
    + "\n".join(f"{10.0 * i} {' '.join(map(str, np.radians(q).round(9)))}" for i, q in enumerate(Q)),
    "bare": "Pose\tA1\tA2\tA3\tA4\tA5\tA6\n"
    + "\n".join("\t".join([name, *map(str, q)]) for name, q in zip(NAMES, Q, strict=True)),
}
EXPORTS = {
    "spatialanalyzer": "// Units: Millimeters\n// Frame: A::WORLD\n"
    + "\n".join(f"A::Robot::{n}, {x}, {y}, {z}" for n, (x, y, z) in zip(NAMES, XYZ, strict=True)),
    "polyworks": "Messbericht\nName;X [mm];Y [mm];Z [mm];Zeit\n"
    + "\n".join(f"{n};{';'.join(map(comma, XYZ[i]))};10:00:{9 * i:02d}" for i, n in enumerate(NAMES)),
    "a line for each coordinate": "Name;Control;Nom;Meas [mm];Dev\n"
    + "\n".join(
        f"{n if axis == 'X' else ''};{axis};{comma(value + 1)};{comma(value)};-1,000"
        for n, p in zip(NAMES, XYZ, strict=True)
        for axis, value in zip("XYZ", p, strict=True)
    ),
    "units below the names": "Metrolog\nFeature;X;Y;Z\n;mm;mm;mm\n"
    + "\n".join(f"{n};{';'.join(map(comma, p))}" for n, p in zip(NAMES, XYZ, strict=True)),
    "header in a comment": "# name x_mm y_mm z_mm\n"
    + "\n".join(f"{n} {x} {y} {z}" for n, (x, y, z) in zip(NAMES, XYZ, strict=True)),
    "leica": "Point Name\tX_mm\tY_mm\tZ_mm\n"
    + "\n".join("\t".join([n, *map(str, p)]) for n, p in reversed(list(zip(NAMES, XYZ, strict=True)))),
}  # fmt: skip


def written(folder: Path, log: str, export: str, encoding: str = "utf-8") -> list[Path]:
    paths = [folder / "log.txt", folder / "export.txt"]
    for path, text in zip(paths, (log, export), strict=True):
        path.write_bytes(text.encode(encoding))
    return paths
