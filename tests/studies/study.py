"""Trace many drawn campaigns and count how often the account is right.

    python tests/studies/study.py --draws 200 --size 1.0 --jobs 2 --kinds backlash,creep --seed 0 -o study.csv
    python tests/studies/study.py --effects 2-6 --draws 20 --seed 0 -o several.csv

With `--effects` each machine has so many effects at once. One row per draw is appended to the CSV as it finishes; draws
that it holds already are not made again.
"""

import os

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import csv
import json
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.campaigns import KINDS, LAGGED, NULLS, OUTSIDE, SEVERAL
from support.scoring import Score, score

EVERY = (*KINDS, *LAGGED, *OUTSIDE, *NULLS, "two")
ARMS = ("boom", "six")
LISTS = ("truth", "found", "equivalents", "unexplained", "named", "stated", "sets")
COLUMNS = [field.name for field in fields(Score)]
RIGHT, IN_CLASS = ("exact", "exact+"), ("exact", "exact+", "class")
Job = tuple[str, int, str, float]


def jobs(draws: int, kinds: Sequence[str], seed: int, size: float) -> list[Job]:
    """Return draws of all kinds in turn, the arms alternating."""
    found = []
    for i in range(draws):
        turn, number = divmod(i, len(kinds))
        found.append((kinds[number], seed + turn, ARMS[(turn + number) % len(ARMS)], size))
    return found


def read_scores(path: Path) -> list[Score]:
    """Return the scores of a file, none where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [Score(**{name: _value(name, row[name]) for name in COLUMNS}) for row in csv.DictReader(file)]


def _value(name: str, text: str):
    if name in LISTS:
        return json.loads(text)
    if name in ("seed", "checked", "covered", "false", "asked"):
        return int(text)
    if name in ("first", "axis"):
        return text == "True"
    if name == "rank":
        return int(text) if text else None
    return text if name in ("kind", "arm", "verdict", "log", "unasked") else float(text)


def append(path: Path, result: Score) -> None:
    """Add one row, the header first."""
    new = not path.exists()
    row = {name: json.dumps(value) if name in LISTS else value for name, value in result.as_row().items()}
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def run(wanted: Sequence[Job], path: Path, workers: int, ask: int = 0) -> list[Score]:
    """Make every draw that the file does not hold, and return all that were wanted."""
    known = {_job(one): one for one in read_scores(path)}
    missing = [job for job in wanted if job not in known]
    start = time.time()
    finished = Parallel(n_jobs=workers, return_as="generator_unordered")(delayed(score)(*job, ask) for job in missing)
    for count, one in enumerate(finished, start=1):
        append(path, one)
        known[_job(one)] = one
        _progress(one, count, len(missing), time.time() - start)
    return [known[job] for job in wanted]


def _job(one: Score) -> Job:
    return one.kind, one.seed, one.arm, one.size


def _progress(one: Score, count: int, total: int, elapsed: float) -> None:
    left = elapsed / count * (total - count) / 60.0
    text = f"[{count}/{total}, {left:.0f} min left] {one.verdict:11s} {one.kind} {one.seed} {one.arm}"
    print(f"{text}  {one.before:.3f} -> {one.after:.3f} mm of {one.floor:.3f}, {one.seconds:.0f} s", flush=True)


HEADER = "draws hidden detected first axis exact class error  before   after /floor    s  max   covered"


def table(scores: Sequence[Score]) -> str:
    """Return one line per kind and for groups of kinds."""
    lines = [f"{'':32s}{HEADER}"]
    for kind in dict.fromkeys(one.kind for one in scores):
        lines.append(_line(kind, [one for one in scores if one.kind == kind]))
    groups = {
        "named": (*KINDS, *LAGGED),
        "outside": OUTSIDE,
        "two at once": ("two",),
        "several": SEVERAL,
        "nothing": NULLS,
    }
    lines.append("")
    for name, kinds in groups.items():
        some = [one for one in scores if one.kind in kinds]
        if some:
            lines.append(_line(name, some))
    return "\n".join(lines)


def _line(name: str, some: Sequence[Score]) -> str:
    def count(*verdicts: str) -> int:
        return sum(one.verdict in verdicts for one in some)

    whole = [one for one in some if one.verdict != "ERROR"]
    checked, seen, first = (
        sum(values) for values in zip(*((s.checked, s.detected, s.first) for s in some), strict=True)
    )
    numbers = [
        f"{len(some):5d} {count('hidden'):6d} {seen:8d} {first:5d}",
        f"{sum(one.first and one.axis for one in some):4d} {count('exact', 'ok'):5d} {count(*IN_CLASS, 'ok'):5d}",
        f"{count('ERROR'):5d} {_median(one.before for one in whole):7.3f} {_median(one.after for one in whole):7.3f}",
        f"{_median(one.after / one.floor for one in whole):6.2f} {_median(one.seconds for one in whole):4.0f}",
        f"{max((one.seconds for one in whole), default=0.0):4.0f}",
        f"{sum(one.covered for one in some):4d}/{checked:<4d}",
    ]
    return f"{name:32s}{' '.join(numbers)}"


def _median(values: Iterable[float]) -> float:
    known = list(values)
    return float(np.median(known)) if known else np.nan


def summary(scores: Sequence[Score]) -> str:
    """Return the headline numbers."""
    null = [one for one in scores if one.kind in NULLS]
    real = [one for one in scores if one.kind not in NULLS and one.verdict != "hidden"]
    checked, covered = sum(one.checked for one in scores), sum(one.covered for one in scores)
    ratios = [one.after / one.floor for one in scores if one.verdict != "ERROR"]
    extra = sum(one.verdict == "exact+" for one in real)
    lines = [
        f"false alarms on nothing   {sum(one.verdict == 'FALSE' for one in null)} of {len(null)}",
        f"hidden by calibration     {sum(one.verdict == 'hidden' for one in scores)}",
        f"of the {len(real)} others: detected {sum(one.detected for one in real)}, "
        f"first right {sum(one.first for one in real)}, all right {sum(one.verdict in RIGHT for one in real)} "
        f"({extra} with something else beside), in the reported class {sum(one.verdict in IN_CLASS for one in real)}",
        f"95 % intervals cover      {covered} of {checked}" + (f" ({covered / checked:.0%})" if checked else ""),
        f"after over the noise      median {_median(ratios):.3f}, worst {max(ratios, default=np.nan):.2f}",
        f"held-out coordinates within 1.96 standard deviations: {np.nanmean([one.within for one in scores]):.1%}",
    ]
    if asked := [one for one in real if one.asked]:
        before, after = (sum(getattr(one, what) in RIGHT for one in asked) for what in ("unasked", "verdict"))
        lines.append(f"rows asked for in {len(asked)} of them: all right {before} before, {after} after")
    return "\n".join([*lines, *_several([one for one in scores if one.named and one.verdict != "ERROR"])])


def _several(scores: Sequence[Score]) -> list[str]:
    """Return what is right where several effects were hidden at once, counted by effects that could be seen."""
    if not scores:
        return []
    named = [word for one in scores for word in one.named if word != "hidden"]
    found, right = sum(len(one.found) for one in scores), sum(one.verdict in IN_CLASS for one in scores)
    exact, false = named.count("exact"), sum(one.false for one in scores)
    within = exact + named.count("class")
    return [
        f"of {len(named)} effects that show among several: exact {exact} ({exact / len(named):.1%}), "
        f"in the reported class {within} ({within / len(named):.1%})",
        f"false names               {false} of {found} ({false / max(found, 1):.1%})",
        f"machines wholly right     {right} of {len(scores)}",
    ]


def confusions(scores: Sequence[Score]) -> str:
    """Return every draw that is not exact, the worst verdicts first."""
    order = ("ERROR", "FALSE", "WRONG", "missed", "unexplained", "hidden", "class", "exact+")
    listed = sorted((one for one in scores if one.verdict in order), key=lambda one: order.index(one.verdict))
    return "\n".join(_confusion(one) for one in listed)


def _confusion(one: Score) -> str:
    head = f"{one.verdict:11s} {one.kind} seed {one.seed} {one.arm} size {one.size:g}"
    sizes = (
        f"{one.before:.3f} -> {one.after:.3f} mm of {one.floor:.3f}, shown {one.shown:.3f} mm, strain {one.strain:.1f}"
    )
    lines = [f"{head}: {sizes}, truth's rank {one.rank}"]
    words = one.named or [""] * len(one.truth)
    lines += [f"    hidden {_brief(e)} {_numbers(e[3])} {word}" for e, word in zip(one.truth, words, strict=True)]
    for found, others in zip(one.found, one.equivalents, strict=True):
        lines.append(f"    found  {_brief(found)} {_numbers(found[5])} evidence {found[6]}")
        lines += [f"           or {', '.join(_brief(other) for other in others[:6])}"] if others else []
    lines += [f"    left   {one.unexplained[:4]}"] if one.unexplained else []
    lines += [f"    {one.log}"] if one.verdict == "ERROR" or "dropping" in one.log else []
    return "\n".join(lines)


def page(scores: Sequence[Score], asked: str) -> str:
    """Return the tables as Markdown, under the options that they were asked with."""
    parts = {f"`study.py {asked}`": summary(scores), "By kind": table(scores), "What is not exact": confusions(scores)}
    return "\n".join(f"### {name}\n\n```text\n{text.strip()}\n```\n" for name, text in parts.items())


def _brief(effect: Sequence) -> str:
    return " ".join(str(part) for part in effect[:3] if part) + (f" {effect[3]}" if isinstance(effect[3], str) else "")


def _numbers(values: dict) -> str:
    texts = {name: f"{value:.3g}" if isinstance(value, float) else value for name, value in values.items()}
    return " ".join(f"{name}={text}" for name, text in texts.items())


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--size", type=float, default=1.0, help="factor on every effect's size")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--kinds", default=",".join(EVERY), help="comma-separated; a kind or kind with ' lagged'")
    parser.add_argument("--effects", help="how many at once, 2-6: those kinds alone")
    parser.add_argument("--ask", type=int, default=0, help="rows asked for and read, twice at most")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("-o", "--output", type=Path, default=Path("study.csv"))
    parser.add_argument("--page", type=Path, help="Markdown of the same tables, for the documentation")
    given = parser.parse_args(arguments)
    kinds = [name.strip() for name in given.kinds.split(",")]
    if given.effects:
        least, _, most = given.effects.partition("-")
        kinds = [f"{count} effects" for count in range(int(least), int(most or least) + 1)]
    unknown = sorted(set(kinds) - {*EVERY, *SEVERAL})
    if unknown:
        parser.error(f"unknown kinds: {', '.join(unknown)}; known: {', '.join(EVERY)}")
    scores = run(jobs(given.draws, kinds, given.seed, given.size), given.output, given.jobs, given.ask)
    print(f"\n{table(scores)}\n\n{summary(scores)}\n\n{confusions(scores)}")
    if given.page:
        given.page.write_text(page(scores, f"--draws {given.draws} --seed {given.seed} --size {given.size:g}"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
