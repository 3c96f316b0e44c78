"""Twenty readings: where they tell most about the boom, and how many poses at random would tell as much."""

import sys

import armflex
from armflex.plan.picture import draw_plan


def main(table: str = "poses.csv", picture: str = "plan.png", rows: int = 20) -> float:
    arm = armflex.load_arm(armflex.bundled_robot("tarm_like") / "measured.toml")
    found = armflex.plan(arm, rows)

    before, after = (found.goal.shown(value) for value in (found.reached[0], found.reached[-1]))
    print(f"{found.goal.title}: {before:.2f} now, {after:.3f} after {rows} readings")
    print(f"poses at random need {found.random_rows} readings for as much")
    for line in found.advice:
        print(line)

    armflex.write_plan(found, table)  # a measurements.csv whose x y z are to be filled in
    draw_plan(found, picture)
    # Afterwards: armflex.plan(arm, 10, after=campaign, between=("backlash:A2", "encoder_eccentricity:A2"))
    return float(after)


if __name__ == "__main__":
    main(*sys.argv[1:3])
