"""Ask an engine that was compiled with sanitizers about damaged tables: what is refused and what is answered, no crash.

python damaged_tables.py LIBRARY COUNT SEED
"""

import sys
import tempfile
import warnings
from ctypes import CDLL
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from support.arms import bundled, networks, positions
from support.machines import MACHINES
from support.sprung_arm import BALANCER, STRUT, TIE, sprung

from armflex import Arm
from armflex.errors import InputError
from armflex.mechanics.engine import binding
from armflex.mechanics.engine.tables import Frames, Laws, Tree

NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1.0, -1.0, 7.0)
WHOLES = (-(2**63), 2**63 - 1, -1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 17, 1000, 2**32)


def loaded_sanitized(path: str) -> None:
    """Have the binding call a library in place of the one that is built."""
    library = CDLL(path)
    for call, (result, arguments) in binding._CALLS.items():
        function = getattr(library, call)
        function.restype, function.argtypes = result, arguments
    binding.library.cache_clear()
    binding.library = lambda: library


def arms(folder: Path) -> list[Arm]:
    found = [bundled(name) for name in ("tarm_like", "heavy_six", "palletizer", "hybrid_lifter")]
    found += [sprung(folder / "springs", (BALANCER, TIE, STRUT), full=True), networks(folder / "networks")]
    return found + [machine.load(folder / name) for name, machine in MACHINES.items()]


def damaged(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an array with a number or two that are others."""
    found = array.copy()
    for _ in range(int(rng.integers(1, 3)) if found.size else 0):
        place = int(rng.integers(found.size))
        whole = found.dtype.kind == "i"
        near = found.flat[place] + rng.integers(-3, 4) if whole else found.flat[place] * rng.normal()
        found.flat[place] = near if rng.random() < 0.5 else rng.choice(np.array(WHOLES if whole else NUMBERS))
    return found


def ask(tree: Tree, laws: Laws, rng: np.random.Generator) -> None:
    """Put every question to the engine; what it says does not matter."""
    rows, n, m, p = int(rng.integers(0, 7)), len(tree.flexures), len(tree.rows), tree.passive
    q = rng.uniform(-1.0, 1.0, (rows, tree.driven))
    q = damaged(q, rng) if rng.random() < 0.3 else q
    engine, twists = binding.Engine(tree), 1e-3 * rng.normal(size=(rows, n, 6))
    links = np.array([[rng.integers(len(tree.parents)), rng.integers(n + 1), side] for side in (0, 1)], dtype=np.int64)
    links = damaged(links, rng) if rng.random() < 0.3 else links
    engine.set_laws(laws, rows)
    engine.set_loads(links, 100.0 * rng.normal(size=(1, 2, 9)), np.zeros((0, 2, 6, 6)), rows)
    shapes = ((p,), (4, 4), (p,), (n, 6), (n, 6), (m,), (6,), (), (m, m))
    into = tuple(np.zeros((rows, *shape)) for shape in shapes)
    engine.rest(q, True, 0, rng.uniform(-1.0, 1.0, p), np.zeros((m, m)), into)
    if not (m or p or len(tree.joins)):
        for motion in (None, damaged(rng.normal(size=(rows, 2, tree.driven)), rng)):
            engine.set_motion(motion, rows)
            engine.rest_chain(q, True, np.empty((rows, 6)), np.empty((rows, n, 6)), twists, np.empty(rows, dtype=bool))
        engine.set_motion(None, rows)
        engine.tips(q, np.empty((rows, 4, 4)))
    places = rng.integers(0, len(tree.parents), (2, 2, 3)).astype(np.int64)
    sites, bodies = [Frames((), place.copy(), rng.normal(size=(3, 12))) for place in places]
    behind, names = 3 * len(tree.joins), list(tree.answers(0, 0))
    where = {"sites": sites, "bodies": bodies, "state": (into[2], into[5], into[8]), "behind": behind}
    for _ in range(3):
        some = rng.permutation(names)[: rng.integers(1, len(names) + 1)]
        engine.respond([str(name) for name in some], q, twists, **where)


def main(library: str, count: int, seed: int) -> None:
    warnings.simplefilter("ignore")
    loaded_sanitized(library)
    rng, refused = np.random.default_rng(seed), 0
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "springs").mkdir(), (Path(folder) / "networks").mkdir()
        for name in MACHINES:
            (Path(folder) / name).mkdir()
        known = []
        for arm in arms(Path(folder)):
            loaded = arm.loaded(None)
            known.append((loaded.tree, arm.stack.numbers))
            q = arm.position() if loaded.tied else positions(arm, 3)
            arm.deflection(q, allow_large=True)  # as it is
        names = [one.name for one in fields(Tree)]
        for _ in range(count):
            tree, laws = known[rng.integers(len(known))]
            if rng.random() < 0.7:
                name = str(rng.choice(names))
                value = getattr(tree, name)
                other = value + int(rng.integers(-2, 3)) if isinstance(value, int) else damaged(value, rng)
                tree = replace(tree, **{name: other})
            else:
                name = str(rng.choice(Laws._fields))
                laws = laws._replace(**{name: damaged(getattr(laws, name), rng)})
            try:
                ask(tree, laws, rng)
            except InputError:
                refused += 1
    print(f"{refused} of {count} refused")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
