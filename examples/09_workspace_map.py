"""Where can the boom carry 600 kg and stay within 100 mm, and where might it not?"""

import sys

import numpy as np

import armflex
from armflex.tasks.workspace import draw_map


def main(picture: str = "workspace.png", rows: int = 2048) -> dict[str, float]:
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
    found = armflex.map_workspace(arm, ["none", "p600"], rows=rows, voxel=1.0, jobs=1)

    worst = found.worst_voxel
    print(f"of {found.rows} configurations, {found.refused.sum()} have no equilibrium")
    most, sigma = found.worst[worst] * 1e3, found.sigma[worst] * 1e3
    print(f"the tip moves {most:.0f} ± {sigma:.0f} mm about {found.centres[worst]} m")
    verdicts = found.verdicts(tolerance=0.1)  # of the worst configuration and payload in every voxel
    shares = {name: float(np.mean(verdicts == name)) for name in ("ok", "uncertain", "fail")}
    print(", ".join(f"{share:.0%} of {len(found)} voxels {name}" for name, share in shares.items()))

    draw_map(arm, found, picture, tolerance=0.1)
    # With dask.distributed installed, the same map from a cluster:
    #   with joblib.parallel_config(backend="dask"): armflex.map_workspace(arm, ...)
    return shares | {"worst": float(found.worst[worst])}


if __name__ == "__main__":
    main(*sys.argv[1:2])
