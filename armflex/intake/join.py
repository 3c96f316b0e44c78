"""Several files to one campaign: what they are together, and everything that is wrong or open in them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from armflex.errors import FEW, ManyErrors, TableError, listing
from armflex.files.arm_file import ROBOTS
from armflex.intake.arm_source import ArmSource, arm_source
from armflex.intake.campaign import Intake, campaign
from armflex.intake.meanings import Ask, Meaning, combined, meanings
from armflex.intake.pairing import named_alike
from armflex.intake.parts import TURNS, gone_on, one_log, with_roles
from armflex.intake.picture_files import camera
from armflex.intake.pointing import is_pointing, joined_runs
from armflex.intake.record import Record, ranked
from armflex.intake.recordings import read_sources
from armflex.intake.settled import in_one_frame, no_place, settled, unturned
from armflex.intake.sources import SourceTable
from armflex.intake.standing import standing


def intake(
    paths: Sequence[str | Path],
    sigma: float | None,
    taken: Mapping[str, str] | None = None,
    ask: Ask | None = None,
    targets: Sequence[str] = (),
    dh: str | None = None,
    *,
    sigma_r: float | None = None,
    board: str | None = None,
    on_arm: bool = False,
    beside: Path | None = None,
    tip: str | None = None,
    joints: Sequence[str] = (),
) -> Intake:
    """Return the campaign that a controller's log and a tracker's export are together, or one file with both.

    A log alone becomes rows without readings: a path, or poses to predict.

    A recording counts where the arm stands: a row for each dwell, with the means of what was recorded in it. Pictures
    of a board, or a table of corners, are an export as well: each row has the name of its picture.

    Args:
        paths: The files, in any order.
        sigma: One standard deviation of a measured coordinate [m]; None where none is measured.
        taken: What columns are where their names do not say it, by name: `q_J1_deg`, `x_mm`, `pose`, `time`.
        ask: Asks where a guess is open; a file is refused there when not given.
        targets: Which topics, bodies or markers of recordings are the targets.
        dh: Form of a table of DH parameters among the files, "standard" or "modified".
        sigma_r: One standard deviation of a recorded orientation [rad]; None leaves orientations out.
        board: The board in pictures as one option, see `board_of`; None where the arm file has it.
        on_arm: Whether the board is on the arm, and not the camera.
        beside: Folder of the campaign, that of the log when not given: what is named in it is relative to this.
        tip: Last link of a URDF among the files, its only leaf when not given.
        joints: Which topics of a recording have the joints, where several have the same ones.

    Raises:
        ManyErrors: With everything that is wrong or open in the files, each with what to do.
        InputError: The arm never stands in a recording, or two recordings do not match.
        TableError: A file is no table.
        UnsupportedError: The package that reads a recording is not installed.
    """
    files, asked = [Path(path) for path in paths], dict(taken or {})
    if any(map(is_pointing, files)):
        return joined_runs(files, asked, sigma)
    sources, wrong = _read(files)
    arm, about = arm_source(files, sources, dh, ask, tip, asked)
    records = [Record(**vars(source), meant=meanings(source, asked, arm.joints, arm.slides_among))
               for source in sources if source is not arm.table]  # fmt: skip
    every = dict.fromkeys(name for source in (*records, *filter(None, [arm.table])) for name in source.header)
    unknown = [name for name in asked if name not in every]
    wrong += about + [f"--take {name}: no file has this column (columns: {listing(every)})" for name in unknown]
    wrong += [text for record in records for text in combined(record, record.meant, asked, arm.joints)]
    for step in (
        partial(one_log, topics=joints),
        partial(with_roles, targets=targets),
        partial(_settled, arm=arm),
    ):
        records, about = step(records, ask=ask)
        wrong += about
    wrong = _together(records, paths, sigma, sigma_r, wrong)
    log, pictures = next((record for record in records if record.role == "log"), None), _pictures(records)
    beside, declared, shown = beside or (log.path.parent if log else Path()), "", list[str]()
    if board is not None and not pictures:
        wrong.append("--board: no folder of pictures and no table of corners is among the files")
    elif board is not None:
        name = next(meaning.name for meaning, _ in pictures[0].of("picture"))
        declared, shown, about = camera(pictures[0], board, on_arm, name, beside)
        wrong += about
    if log is not None and sum(record.role == "log" for record in records) == 1:
        named, about = arm.named(log)
        records = [named if record is log else record for record in records]
        wrong += about
    if wrong:
        raise ManyErrors(wrong)
    records, notes = standing(_unburdened(records))
    about = dict.fromkeys(note for record in ranked(records) for note in record.notes)
    joined = campaign(records, (sigma, sigma_r), beside, [*shown, *notes, *about])
    joined = replace(joined, declare="\n\n".join(filter(None, (joined.declare, declared))))
    return arm.described(joined, beside, any(record.has("coordinate") for record in ranked(records)))


def _pictures(records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record.role != "log" and record.has("picture")]


def _read(paths: Sequence[Path]) -> tuple[list[SourceTable], list[str]]:
    """Return what the files have that do not describe a robot, and why others cannot be read."""
    sources, wrong = list[SourceTable](), list[str]()
    for path in paths:
        try:
            sources += read_sources(path) if path.suffix.lower() not in ROBOTS else []
        except TableError as error:
            wrong.append(str(error))
    return gone_on(sources), wrong


def _settled(records: Sequence[Record], ask: Ask | None, arm: ArmSource) -> tuple[list[Record], list[str]]:
    """Return records in which nothing is open, and what is wrong with each, see `settled`."""
    closed, wrong = list[Record](), list[str]()
    for record in records:
        if record.role or record.has("picture"):
            slides = arm.slides_among([joint.name for joint, _ in record.of("joint")]) or ()
            record, about = settled(record, ask, slides, bool(record.role) and record.has("coordinate"))
            wrong += about
        elif not record.part:
            wrong.append(no_place(record, joints=False))
        closed.append(record)
    if len(records) == 1 and records[0].role == "log" and not records[0].has("coordinate"):
        wrong += filter(None, [no_place(records[0], joints=True)])
    return closed, wrong


def _together(
    records: Sequence[Record],
    paths: Sequence[str | Path],
    sigma: float | None,
    sigma_r: float | None,
    wrong: Sequence[str],
) -> list[str]:
    """Return what is wrong with records, and with all of them together: one log, and exports that have what is said."""
    wrong = list(wrong)
    logs = sum(record.role == "log" for record in records)
    points = [record for record in ranked(records) if record.has("coordinate")]
    pictures = len(_pictures(records))
    if not wrong and (logs != 1 or pictures > 1 or (not points and not pictures and len(records) > 1)):
        text = f"{logs} files have joints and {len(points)} have x y z"
        text += f", {pictures} are pictures" if pictures else ""
        wrong.append(f"{listing(map(str, paths), FEW)}: {text}: give one log and one export, or one file of both")
    if points and sigma is None:
        wrong.append("the files have coordinates: --sigma 0.05mm says how well one is measured")
    if sigma is not None and not points and not pictures:
        wrong += dict.fromkeys(f"--sigma, and {record.unread}" for record in records if record.unread)
    wrong += in_one_frame([record for record in points if record.role == "export"])
    if sigma_r is not None and points:
        wrong += unturned(points)
    for record in records:
        stds = [meaning.column for meaning in record.meant if meaning.kind != "unused"]
        stds = [name for name in stds if name.startswith("sigma")]
        if not stds or not record.has("coordinate"):
            continue
        if record.role == "log" and all(meaning.column.startswith("q_") for meaning, _ in record.of("joint")):
            text = "has x y z and sigma, as a campaign: calibrate and trace read one as it is"
        else:
            text = f"column {stds[0]!r} says how well a coordinate is measured, as --sigma does:"
            text += f" --take '{stds[0]}=unused' where that is right"
        wrong.append(f"{record.path}: {text}")
    return wrong


def _unburdened(records: Sequence[Record]) -> list[Record]:
    """Return records of which the log's rows are named as points are, and exports keep only causes beside readings."""
    kept, exports = list[Record](), [record for record in ranked(records) if record.role == "export"]
    records = [named_alike(record, exports) if record.role == "log" else record for record in records]
    logs = [record for record in records if record.role == "log"]
    for record in records:
        beside = {meaning.column.partition(" ")[0].lower() for meaning in record.meant} & {*TURNS}
        if record.role == "log" and record.has("coordinate") and len(beside) >= 3:
            text = "x y z stand beside the joints, with angles of the tool as controllers log them: these compute them"
            record = replace(record, notes=(*record.notes, f"{text} from the joints; are they measured?"))
        if record.role == "export":  # what an instrument's program says of its own readings is no cause
            record = named_alike(record, logs).where(Meaning.is_signal, kind="unused", why="of the instrument")
        kept.append(record)
    return kept
