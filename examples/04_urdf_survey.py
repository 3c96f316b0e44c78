"""How many of the URDFs in PyPI's example-robot-data load, with what doubts, and why the others do not."""

import warnings
from collections import Counter
from importlib.metadata import distribution
from pathlib import Path

from armflex import Arm, ArmflexWarning, InputError, load_arm
from armflex.robot.robot import check_tree
from armflex.robot.urdf import MOVING, read_urdf


def main() -> tuple[list[str], dict[str, str]]:
    """Return the files that load as an arm, and those that do not with the reason."""
    root = Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))
    files = sorted(root.rglob("*.urdf"))
    loaded, refused = [], {}
    for file in files:
        name = str(file.relative_to(root))
        try:
            arm = deepest(file)
        except InputError as error:
            refused[name] = str(error).replace(f"{root}/", "")
        else:
            loaded.append(name)
            flags = Counter(flag.code for flag in arm.flags if flag.code != "rigid")
            said = ", ".join(f"{count} {code}" for code, count in flags.items()) or "no doubts"
            print(f"{name}: {len(arm.joint_names)} joints to {arm.robot.tip}; {said}")
    print(*refused.values(), sep="\n")
    print(f"{len(loaded)} of {len(files)} load")
    return loaded, refused


def deepest(file: Path) -> Arm:
    """Return the arm to the tip with the most joints that loads: fingers without a weight are no tip."""
    document = read_urdf(file)
    depth, ends = {}, []
    for link in document.below(check_tree(document)):
        joint = document.parents.get(link)
        if joint is None:
            depth[link] = 0
        elif joint.parent in depth and not (joint.faults or joint.mimic):
            depth[link] = depth[joint.parent] + (joint.kind in MOVING)
    ends = sorted(depth, key=lambda link: (-depth[link], any(one.child in depth for one in document.children[link])))
    first = None
    for tip in ends:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ArmflexWarning)
                return load_arm(file, tip=tip)
        except InputError as error:
            first = first or error
    raise first


if __name__ == "__main__":
    main()
