"""How often a campaign in another convention than its arm's is named, and a clean one accused.

    python tests/studies/misread.py --draws 20 [ARM.toml CAMPAIGN.csv ...]     (3 minutes of CPU)

Every fault of `support.misread_campaigns` is done to a simulated campaign of the bundled boom and of a UR5, those of
joints and loads to machines of the plant with one undeclared effect each as well, and to campaigns of real machines
that are given by pairs. A fault that moves the readings no further than the arm as it stands explains cannot be named.
"""

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaigns import KINDS, NULLS, OUTSIDE
from support.misread_campaigns import boom, exchanged_targets, faults, judged, silent, ur5, with_targets

from armflex import load_arm, read_measurements


def main() -> None:
    """Print a line for every fault, a table, and who was accused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("files", nargs="*", type=Path)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    counts: dict[str, Counter[str]] = {}
    accused, clean = [], 0
    for title, arm, rows, which in campaigns(asked.draws, asked.files):
        clean += 1
        print(f"{title}: {len(which)} faults", file=sys.stderr, flush=True)  # each takes some seconds
        if said := judged(arm, rows):
            accused.append(f"{title}: {said}")
        for fault in which:
            said = judged(*fault.written(arm, rows))
            how = "named" if said and fault.named in said[0] else "wrongly named" if said else "silent"
            counts.setdefault(fault.title or fault.named, Counter())[how] += 1
            if how != "named":
                print(f"{title}: {fault.title or fault.named}: {how} {list(said[:3])}", flush=True)
    columns = ("named", "wrongly named", "silent")
    print(f"{'':56}" + "".join(f"{name:>15}" for name in columns))
    for name, count in counts.items():
        print(f"{name[:55]:56}" + "".join(f"{count[one]:15d}" for one in columns))
    print(f"{'all':56}" + "".join(f"{sum(count[one] for count in counts.values()):15d}" for one in columns))
    print(f"{len(accused)} of {clean} clean campaigns accused")
    print("\n".join(accused))


def campaigns(count: int, files: list[Path]):
    """Yield title, arm, campaign, and what is done to it: nothing to machines that only must not be accused."""
    for title, (arm, rows) in (("boom", boom()), ("UR5", ur5())):
        yield title, arm, rows, (*faults(arm), *silent(arm, rows))
        for tracker in (False, True):
            two = with_targets(arm, rows, tracker)
            yield f"{title}, two targets", *two, (*exchanged_targets(*two),)
    kinds = (*KINDS, *NULLS, *OUTSIDE)
    for seed in range(count):
        kind, name = kinds[seed % len(kinds)], ("boom", "six")[(seed + seed // len(kinds)) % 2]
        arm, rows = boom(kind, 5000 + seed, name)
        yield f"{name} {kind}", arm, rows, (*faults(arm),) if seed % 10 == 0 else ()
        yield f"UR5, wave {seed}", *ur5(seed, 2e-4 * seed), ()
    for path, table in zip(files[::2], files[1::2], strict=True):
        arm = load_arm(path)
        yield table.parent.name, arm, read_measurements(table, arm), (*faults(arm),)


if __name__ == "__main__":
    main()
