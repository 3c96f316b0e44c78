"""How many of the URDFs in PyPI's example-robot-data load, and why the others do not."""

from importlib.metadata import distribution
from pathlib import Path

from armflex import InputError, load_robot
from armflex.robot.tree import check_tree, deepest_leaf
from armflex.robot.urdf import read_urdf


def main() -> tuple[int, int]:
    root = Path(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))
    files = sorted(root.rglob("*.urdf"))
    loaded = 0
    for file in files:
        try:
            document = read_urdf(file)
            load_robot(file, deepest_leaf(document, check_tree(document)))
            loaded += 1
        except InputError as error:
            print(str(error).replace(f"{root}/", ""))
    print(f"{loaded} of {len(files)} load")
    return loaded, len(files)


if __name__ == "__main__":
    main()
