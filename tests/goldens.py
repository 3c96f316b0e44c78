"""What the program said before a change of its form: names, places and numbers that must stay as they are.

    python tests/goldens.py commands study measured [--write] [--measured DIR] [--jobs 2]

`commands` runs every command that has a `--json` on the bundled arms (`test_goldens.py` does so in the suite), `study`
traces 60 drawn campaigns, `measured` the campaigns of a folder that holds `sealed_1` to `sealed_5` and
`hilti_trailblazer`. Each is compared with `tests/goldens/`; `--write` makes those files anew, which a commit must say
why.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from support.small_arms import ROBOTS

GOLDENS = Path(__file__).parent / "goldens"
RELATIVE = 1e-6
"""Difference of two numbers, relative to the larger, below which they are the same: fits end by a tolerance."""
NOTHING = 1e-9
"""Below it [m, rad and the like] a number is rounding."""
TIED = 5e-4
"""The same of a probability: it is a mean over resamples, of which single ones end where rounding leads them."""
NOT_COMPARED = frozenset({"seconds", "version", "created", "armflex"})

TARM, HEAVY = ROBOTS / "tarm_like", ROBOTS / "heavy_six"
COMMANDS: dict[str, tuple[object, ...]] = {
    "deflect_tarm": ("deflect", TARM / "arm.toml", "--q", "A1=0.3,A4=-0.2", "--payload", "p300"),
    "deflect_heavy": ("deflect", HEAVY / "arm.toml", "--q", "J2=0.3,J3=-0.2"),
    "modes_heavy": ("modes", HEAVY / "arm.toml", "--payload", "p100"),
    "export_heavy": ("export", HEAVY / "arm.toml", "--to", "urdf", "-o", "out.urdf"),
    "predict_tarm": ("predict", TARM / "measured.toml", TARM / "held_out.csv", "-o", "rows.csv"),
    "check_tarm": ("check", TARM / "arm.toml", TARM / "trajectory.csv", "--tolerance", "50mm"),
    "check_heavy": ("check", HEAVY / "arm.toml", HEAVY / "trajectory.csv", "--tolerance", "5mm"),
    "compensate_tarm": ("compensate", TARM / "arm.toml", TARM / "trajectory.csv", "-o", "out.csv"),
    "compensate_heavy": ("compensate", HEAVY / "arm.toml", HEAVY / "trajectory.csv", "-o", "out.csv"),
    "train_linear": ("train", TARM / "a4_table_1.csv", "--model", "linear", "-o", "a4.safetensors"),
    "train_polynomial": ("train", TARM / "a4_table_1.csv", "--model", "polynomial", "-o", "a4.safetensors"),
    "train_neural": (
        *("train", TARM / "a4_table_1.csv", "--model", "neural"),
        *("--neurons", "6", "--starts", "2", "-o", "a4.safetensors"),
    ),
    "calibrate_tarm": ("calibrate", TARM / "measured.toml", TARM / "campaign.csv", "-o", "fitted.toml"),
    "trace_tarm": ("trace", TARM / "measured.toml", TARM / "campaign.csv", "-o", "traced.toml"),
    "plan_heavy": ("plan", HEAVY / "arm.toml", "--rows", "6", "-o", "poses.csv"),
    "map_heavy": (
        "map",
        HEAVY / "arm.toml",
        "--tolerance",
        "5mm",
        "--voxel",
        "0.5m",
        "--rows",
        "4096",
        "-o",
        "map.safetensors",
    ),
    "view_heavy": ("view", HEAVY / "arm.toml", "-o", "page.html"),
}
CAMPAIGNS = {
    **{f"sealed_{i}": (f"sealed_{i}/arm.toml", f"sealed_{i}/train.csv") for i in range(1, 6)},
    "hilti_flat": ("hilti_trailblazer/arm.toml", "hilti_trailblazer/flat.csv"),
}


def differences(golden: object, found: object, where: str = "") -> Iterator[str]:
    """Yield where two JSON values differ: by more than rounding, in a name, or in what is there."""
    if isinstance(golden, dict) and isinstance(found, dict):
        for name in sorted({*golden, *found} - NOT_COMPARED):
            here = f"{where}.{name}"
            if name not in golden or name not in found:
                yield f"{here}: {'new' if name not in golden else 'missing'}"
            else:
                yield from differences(golden[name], found[name], here)
    elif isinstance(golden, list) and isinstance(found, list):
        if len(golden) != len(found):
            yield f"{where}: {len(found)} entries, there were {len(golden)}"
        for i, (one, other) in enumerate(zip(golden, found, strict=False)):
            yield from differences(one, other, f"{where}[{i}]")
    elif isinstance(golden, float | int) and isinstance(found, float | int) and not isinstance(golden, bool):
        nothing = TIED if where.endswith("probability") else NOTHING
        if not math.isclose(golden, found, rel_tol=RELATIVE, abs_tol=nothing):
            yield f"{where}: {found!r}, it was {golden!r}"
    elif golden != found:
        yield f"{where}: {found!r}, it was {golden!r}"


def command_json(arguments: Sequence[object]) -> dict:
    """Return what a command writes to `--json`, run in this process in a folder of its own."""
    from armflex.cli.main import armflex

    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            armflex.main([*map(str, arguments), "--json", "out.json"], standalone_mode=False)
        return json.loads(Path("out.json").read_text().replace(f"{ROBOTS}/", ""))


def compare(name: str, found: object, write: bool = False) -> list[str]:
    """Return the differences from a golden file, none where it is written anew."""
    path = GOLDENS / f"{name}.json"
    if write:
        GOLDENS.mkdir(exist_ok=True)
        path.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
        return []
    return list(differences(json.loads(path.read_text()), json.loads(json.dumps(found))))


def study(jobs: int) -> dict:
    """Return names, places, values, evidence and stated probabilities of what is found in 60 drawn campaigns."""
    from studies.reliability import log_score, statements
    from studies.study import EVERY, run
    from studies.study import jobs as drawn

    with tempfile.TemporaryDirectory() as folder:
        scores = run(drawn(60, EVERY, 1000, 1.0), Path(folder) / "study.csv", jobs)
    keys = ("verdict", "found", "equivalents", "unexplained", "before", "after", "stated")
    said = {f"{one.kind} {one.seed} {one.arm}": {key: getattr(one, key) for key in keys} for one in scores}
    return said | {"log score": log_score(statements(scores))}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="+", choices=("commands", "study", "measured"))
    parser.add_argument("--write", action="store_true", help="make the files anew")
    parser.add_argument("--measured", type=Path, help="folder of the campaigns")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="of the names of commands or campaigns, those that contain it")
    given = parser.parse_args(arguments)
    found: dict[str, object] = {}
    if "commands" in given.what:
        found |= {name: command_json(COMMANDS[name]) for name in COMMANDS if given.only in name}
    if "measured" in given.what:
        if given.measured is None:
            parser.error("measured: give --measured DIR")
        for name, files in CAMPAIGNS.items():
            if given.only in name:
                arm, rows = (given.measured / file for file in files)
                said = json.dumps(command_json(("trace", arm, rows, "-o", "traced.toml")))
                found[f"measured_{name}"] = json.loads(said.replace(f"{given.measured}/", ""))
    if "study" in given.what:
        found["study"] = study(given.jobs)
    failed = False
    for name, values in found.items():
        wrong = compare(name, values, given.write)
        failed |= bool(wrong)
        print(f"{name}: {'written' if given.write else f'{len(wrong)} differences' if wrong else 'the same'}")
        for line in wrong[:20]:
            print(f"    {line}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
