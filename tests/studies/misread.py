"""How often a campaign in another convention than its arm's is named, and a clean one accused.

    python tests/studies/misread.py --draws 20 [ARM.toml CAMPAIGN.csv ...]

Machines of the plant with one undeclared effect each, and campaigns of real machines that are named by pairs. Every
fault of `support.misread_campaigns` is done to each of them that can have it: an arm without flexures has no compliance
to be written wrong. A fault that does not move the readings further than the arm as it stands explains them cannot be
named; what that leaves is printed with the rest.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaigns import KINDS, draw
from support.misread_campaigns import faults, judged

from armflex import load_arm, read_measurements


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("files", nargs="*", type=Path)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    named, tried, accused, clean = Counter(), Counter(), [], 0
    for title, arm, rows in (*drawn(asked.draws), *given(asked.files)):
        clean += 1
        if said := judged(arm, rows):
            accused.append(f"{title}: {said}")
        for fault in faults(arm):
            tried[fault.named] += 1
            said = judged(*fault.written(arm, rows))
            named[fault.named] += any(fault.named in name for name in said[:1])
            if not any(fault.named in name for name in said[:1]):
                print(f"{title}: {fault.named}: said {list(said[:3])}", flush=True)
    for name, count in tried.items():
        print(f"{named[name]:4d} of {count:4d}  {name}")
    print(f"{sum(named.values())} of {sum(tried.values())} named first; {len(accused)} of {clean} clean ones accused")
    print("\n".join(accused))


def drawn(count: int):
    """Yield machines of the plant, both arms in turn."""
    for seed in range(count):
        kind, arm = KINDS[seed % len(KINDS)], ("boom", "six")[seed % 2]
        with tempfile.TemporaryDirectory() as folder:
            truth = draw(kind, seed=5000 + seed, arm=arm).write(Path(folder))
            loaded = load_arm(truth.arm)
            yield f"{arm} {kind}", loaded, read_measurements(truth.train, loaded)


def given(files: list[Path]):
    """Yield campaigns of real machines."""
    for path, table in zip(files[::2], files[1::2], strict=True):
        arm = load_arm(path)
        yield table.parent.name, arm, read_measurements(table, arm)


if __name__ == "__main__":
    main()
