"""Check a path through via-points, cancel the sag along it, and draw it."""

import armflex


def main(page: str = "path.html") -> float:
    folder = armflex.bundled_robot("heavy_six")
    arm = armflex.load_arm(folder / "arm.toml")
    path = armflex.read_trajectory(folder / "trajectory.csv", arm)

    report = armflex.check(arm, path, tolerance=0.005)
    for point in report.via_points:  # worst first
        print(f"{point.name}: {point.displacement_m * 1e3:.2f} mm, {point.verdict}, because of {point.cause}")

    result = armflex.compensate(arm, path, match="pose")
    left = max(abs(row.after).max() for row in result.rows)
    print(f"after compensation {left:.1e} (m, rad) remain at the rows, {result.between_m:.1e} m between them")
    armflex.view(arm, trajectory=path, report=report, path=page)
    return left


if __name__ == "__main__":
    main()
