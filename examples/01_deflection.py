"""How far does the boom's tip move under 600 kg, and which joint is to blame?"""

import numpy as np

import armflex


def main() -> float:
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "arm.toml")
    q = arm.position(M1=3.0, A3=0.5, A4=-0.5)  # m and rad; joints not named are at zero
    found = arm.deflection(q, payload="p600")

    sag = np.linalg.norm(found.displacement[:3])  # base axes: shift [m], then rotation vector [rad]
    sigma = np.sqrt(np.diag(found.covariance)[:3])
    print(f"the tip moves {sag * 1e3:.1f} mm; standard uncertainty x y z {np.round(sigma * 1e3, 1)} mm")
    for name, load, share in zip(arm.flexure_names, found.wrenches, found.contributions, strict=True):
        print(f"{name}: load {load[:3].round()} N {load[3:].round()} Nm, moves the tip by {share[:3] * 1e3} mm")
    return sag


if __name__ == "__main__":
    main()
