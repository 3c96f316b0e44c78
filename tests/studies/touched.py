"""What a command goes through: files and functions of the package that run once everything is warm.

    python tests/studies/touched.py [-v]

A command is run twice in one process, the second time counted, so that imports and what is made once are left out.
Functions are those with `def` or `lambda`, methods and properties included; comprehensions and class bodies are not.
`trace` is of the bundled arm's campaign. With -v every file is told with the functions of it that ran.
"""

import argparse
import contextlib
import io
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from types import CodeType, FrameType
from unittest.mock import patch

import armflex
from armflex.cli.main import main as armflex_main

PACKAGE = str(Path(armflex.__file__).parent)
BOOM = Path(__file__).parents[2] / "robots" / "tarm_like"
GOALS = {"deflect": (22, 170), "trace": (75, 550)}
UNNAMED = ("<module>", "<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>")
OPTIMIZED = 1
"""Flag of the code of a function; a class body has none."""


def run(arguments: list[str]) -> None:
    """Run a command with nothing printed; raise where it fails."""
    said = io.StringIO()
    with (
        patch.object(sys, "argv", ["armflex", *arguments]),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        try:
            armflex_main()
        except SystemExit as end:
            if end.code:
                raise RuntimeError(said.getvalue()) from None


def touched(arguments: list[str]) -> dict[str, set[str]]:
    """Return the functions of every file that the second run of a command enters."""
    codes: set[CodeType] = set()

    def enter(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            codes.add(frame.f_code)

    run(arguments)
    sys.setprofile(enter)
    try:
        run(arguments)
    finally:
        sys.setprofile(None)
    found = defaultdict(set)
    for code in codes:
        named = code.co_flags & OPTIMIZED and code.co_name not in UNNAMED
        if named and code.co_filename.startswith(PACKAGE):
            found[code.co_filename.removeprefix(PACKAGE + "/")].add(f"{code.co_qualname}:{code.co_firstlineno}")
    return dict(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-v", "--verbose", action="store_true", help="Tell the functions of every file.")
    verbose = parser.parse_args().verbose
    with tempfile.TemporaryDirectory() as folder:
        arm = str(BOOM / "arm.toml")
        commands = {
            "deflect": ["deflect", arm, "--payload", "p300"],
            "trace": ["trace", arm, str(BOOM / "campaign.csv"), "-o", str(Path(folder) / "traced.toml")],
        }
        print(f"{'command':>10} {'files':>6} {'goal':>5} {'functions':>10} {'goal':>5}")
        for name, arguments in commands.items():
            found = touched(arguments)
            functions = sum(map(len, found.values()))
            print(f"{name:>10} {len(found):>6} {GOALS[name][0]:>5} {functions:>10} {GOALS[name][1]:>5}")
            for file, names in sorted(found.items(), key=lambda pair: -len(pair[1])) if verbose else ():
                print(f"{len(names):>10} {file}: {', '.join(sorted(names))}")


if __name__ == "__main__":
    main()
