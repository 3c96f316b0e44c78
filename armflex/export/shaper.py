"""Input shapers of the motions of a path as C99: when, and by which shares, a motion is given to the drives."""

from pathlib import Path

from armflex.arm import Arm
from armflex.export import Exported
from armflex.export.c_text import c_number, check_name
from armflex.export.quoting import c_comment
from armflex.tasks.calm import SLOWER, calm
from armflex.trajectory import read_trajectory

FUNCTION = """
/* Return how far along its way motion `number` is at a time [s] after it began; `way` returns that of the motion as it
 * is without a shaper, 0 before it begins and the same from its end on. */
double NAME_shaped(int number, double time, double (*way)(double time))
{
    double along = 0.0;
    for (int i = 0; i < NAME_impulses[number]; i++) {
        along += NAME_sizes[number][i] * way((time - NAME_times[number][i]) * NAME_speedups[number]);
    }
    return along;
}
"""


def export(
    arm: Arm, traj: Path, name: str = "shaper", slower: float = SLOWER, arm_file: str = "", **loads: object
) -> Exported:
    """Return the impulses that `calm` chooses for each motion of a path, and a function that applies them.

    Args:
        arm: The arm.
        traj: The path, a trajectory.csv.
        name: What every name in the file begins with.
        slower: How many times as long a motion may take.
        arm_file: What the arm was read from, for the head of the file.
        loads: `unnamed`, what loads rows that name nothing; `covariates`, what the arm's effects depend on.

    Raises:
        InputError: The name is no identifier of C, or as `calm`.
    """
    check_name(name)
    covariates = loads.pop("covariates", None)
    calmed = calm(arm, read_trajectory(traj, arm, **loads), slower, covariates)  # pyright: ignore[reportArgumentType]
    most = max((len(motion.times) for motion in calmed.motions), default=1)
    rows = [[[*row, *[0.0] * (most - len(row))] for row in (motion.times, motion.sizes)] for motion in calmed.motions]
    said = [f"{motion.via or 'motion ' + str(i)}: {motion.shaper or 'none'}" for i, motion in enumerate(calmed.motions)]
    count, lengths = max(len(calmed.motions), 1), ", ".join(str(len(motion.times)) for motion in calmed.motions)
    head = f"Input shapers of the motions in {traj.name} for {arm_file or arm!r}, from rest to rest."
    speedups = [motion.speedup for motion in calmed.motions] or [1.0]
    text = "\n".join(
        [
            f"/* {c_comment(head)} */",
            *(f"/* {c_comment(line)} */" for line in said),
            f"enum {{ {name}_motions = {len(calmed.motions)} }};",
            f"const int {name}_impulses[{count}] = {{{lengths or '0'}}};",
            f"const double {name}_speedups[{count}] = {c_number(speedups)};",
            f"const double {name}_times[{count}][{most}] = {c_number([row[0] for row in rows] or [[0.0]])}; /* s */",
            f"const double {name}_sizes[{count}][{most}] = {c_number([row[1] for row in rows] or [[0.0]])};",
            FUNCTION.replace("NAME", name),
        ]
    )
    numbers = {"motions": calmed.motions}
    return Exported(text, tuple(said), numbers, calmed.flags)
