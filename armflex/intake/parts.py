"""Which parts of recordings count: topics with the joints, bodies and markers that are targets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armflex.errors import FEW, did_you_mean, listing
from armflex.intake.bags import together
from armflex.intake.meanings import Ask
from armflex.intake.record import Record
from armflex.intake.sources import SourceTable, numbers

TURNS = ("a", "b", "c", "w", "p", "r", "rx", "ry", "rz")
"""Columns beside a controller's own X Y Z that are the orientation of its tool."""


def gone_on(sources: Sequence[SourceTable]) -> list[SourceTable]:
    """Return sources in which a part of a recording that goes on in another file is whole, and stands once."""
    whole = list[SourceTable]()
    for source in sources:
        alike = (i for i, other in enumerate(whole) if (other.part, other.header) == (source.part, source.header))
        recorded = source.header[:1] == ("time",) and all(isinstance(cells, np.ndarray) for cells in source.columns)
        at = next(alike, None) if source.part and recorded else None
        if at is None:
            whole.append(source)
            continue
        first, second = sorted((whole[at], source), key=lambda part: part.columns[0][0])
        pairs = [(numbers(before), numbers(after)) for before, after in zip(first.columns, second.columns, strict=True)]
        if first.path != second.path and pairs[0][0].max() < pairs[0][1].min():
            columns = tuple(np.concatenate(pair) for pair in pairs)
            lines, notes = (*first.lines, *second.lines), (*first.notes, *second.notes)
            whole[at] = replace(
                first, lines=lines, columns=columns, notes=notes, doubts={**first.doubts, **second.doubts}
            )
        elif not all(np.array_equal(before, after, equal_nan=True) for before, after in pairs):
            whole.append(source)
    return whole


def one_log(records: list[Record], topics: Sequence[str], ask: Ask | None) -> tuple[list[Record], list[str]]:
    """Return records with the joints of a recording's topics as one log, and what is wrong.

    Joints with different names are joined over time; where two topics have the same joint, one of them is chosen.
    """
    logs = [record for record in records if record.part and record.has("joint")]
    parts = {record.part: record for record in logs}
    if unknown := [name for name in topics if name not in parts]:
        hint = did_you_mean(unknown[0], parts)
        return records, [f"--joints {unknown[0]}: no recording has joints there{hint} (they are in: {listing(parts)})"]
    of_topic = {part: {meaning.name for meaning, _ in record.of("joint")} for part, record in parts.items()}
    chosen = list(topics) or list(parts)
    if alike := _called_alike(logs, chosen):
        return records, alike
    for part in chosen:
        rivals = [other for other in chosen if of_topic[other] & of_topic[part]]
        if len(rivals) > 1 and ask is not None and not topics:
            answer = ask("Which of these topics has the joints?", rivals)
            chosen = [other for other in chosen if other not in rivals or other == answer]
        elif len(rivals) > 1:
            both = listing(sorted(of_topic[rivals[0]] & of_topic[rivals[1]]))
            text = f"{listing(rivals)} have the same joints ({both}): --joints {rivals[0]}, or the other"
            return records, [f"{parts[part].path}: {text}"]
    of_arm = [record for part, record in parts.items() if part in chosen]
    kept = [record for record in records if record not in logs or record in of_arm]
    if len(of_arm) < 2 or len({record.path for record in of_arm}) > 1:
        return kept, []
    merged, meant = together([*of_arm]), {one.column: one for record in of_arm for one in record.meant}
    whole = Record(**vars(merged), meant=tuple(meant[name] for name in merged.header))
    return [whole if record is of_arm[0] else record for record in kept if record not in of_arm[1:]], []


def with_roles(records: list[Record], targets: Sequence[str], ask: Ask | None) -> tuple[list[Record], list[str]]:
    """Return records with what they are in the join, and what is wrong: all files count, of recordings the targets.

    Places beside the joints are the controller's own where an export has others.
    """
    placed = [record for record in records if record.has("coordinate")]
    parts = {record.part: record for record in placed if record.part}
    stamped, wrong = list(targets) or [name for name in parts if "->" not in name] or list(parts), list[str]()
    if unknown := [name for name in targets if name not in parts]:
        hint, stamped = did_you_mean(unknown[0], parts), []
        wrong.append(f"--target {unknown[0]}: no recording has it{hint} (they have: {listing(parts)})")
    elif len(stamped) > 1 and not targets and ask is not None:
        stamped = [ask("Which of these is the target?", stamped)]
    elif len(stamped) > 1 and not targets:
        text = f"several could be the target: {listing(stamped)}: --target '{stamped[0]}', one or more times"
        stamped, wrong = [], [text]
    wrong += _called_alike(placed, stamped)
    if stamped and not targets and (left := [name for name in parts if name not in stamped]):
        text = f"{listing(left, FEW)} moves, too, and is no target: --target NAME says another"
        records = [replace(one, notes=(*one.notes, text)) if one is parts[stamped[0]] else one for one in records]
        parts[stamped[0]] = next(record for record in records if record.part == stamped[0])
    points = [*(record for record in placed if not record.part), *(parts[name] for name in stamped)]
    exports, roles = [record for record in points if not record.has("joint")], list[Record]()
    for record in records:
        if record.has("joint"):
            record = replace(record, role="log")
            if exports and record.has("coordinate"):
                why = "the controller's own, computed from its joints"
                of_tool = [column for column in record.meant if column.kind in ("coordinate", "turn")]
                of_tool += [column for column in record.meant if column.name.lower() in TURNS]
                record = record.where(of_tool.__contains__, kind="unused", unit="", why=why)
        elif record in exports:
            record = replace(record, role="export", rank=exports.index(record))
        roles.append(record)
    return roles, wrong


def _called_alike(records: Sequence[Record], chosen: Sequence[str]) -> list[str]:
    """Return what is wrong where a chosen part of a recording is not the only one of its name."""
    for name in chosen:
        several = [record.path for record in records if record.part == name]
        if len(several) > 1:
            files = listing(map(str, dict.fromkeys(several)), FEW)
            text = f"{len(several)} parts are called {name!r}, and they differ: call each by a name of its own,"
            return [f"{files}: {text} or make a campaign of each recording and give all to calibrate"]
    return []
