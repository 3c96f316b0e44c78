"""armflex intake: files as people have them into a campaign."""

from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import say, say_written
from armflex.errors import InputError
from armflex.measured.table import write_table
from armflex.storage.whole_file import together, write_whole


@click.command(cls=options.Command)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=options.InputPath)
@options.as_they_are
@click.option("--dh", type=options.Choice(["standard", "modified"]),
              help="Form of a table of DH parameters among the files.")  # fmt: skip
@click.option("--board", metavar="charuco,8x6,30mm,22mm",
              help="The board in a folder of pictures: kind, columns x rows, lengths of its print, for charuco and "
                   "apriltag also the dictionary. Without it the arm file must declare the board.")  # fmt: skip
@click.option("--board-on-arm", is_flag=True, help="The board is on the arm and the camera beside it.")
@click.option("--tip", metavar="LINK", help="Last link of the arm, where a URDF among the files ends in several.")
@click.option("--arm", "arm_path", metavar="ARM.toml", type=options.OutputPath(),
              help="Arm file to write, where a URDF, a table of DH parameters or a pointing run is given; cameras, "
                   "further targets and the star are in it.")  # fmt: skip
@click.option("-o", "--output", required=True, type=options.OutputPath(), help="Campaign to write.")
def command(
    paths: tuple[Path, ...],
    sigma: float | None,
    sigma_r: float | None,
    take: tuple[str, ...],
    targets: tuple[str, ...],
    joints: tuple[str, ...],
    dh: str | None,
    board: str | None,
    board_on_arm: bool,
    tip: str | None,
    arm_path: Path | None,
    output: Path,
) -> None:
    """Write a campaign from a controller's log and a tracker's export, or from one file that has both.

    A log alone becomes a path, each row a via-point. A URDF or a table of DH parameters becomes an arm file with --arm.
    A folder of pictures is joined by names, numbers or times; --board describes the board that they show.

    Files may be text (separated by semicolons, commas, tabs or blanks; decimal commas, comments, titles; UTF-8, UTF-16
    or Windows-1252), workbooks, ROS bags (rosbag2, MCAP), exports of Motive, Vicon, Qualisys or NDI, C3D, traces of
    KUKA controllers, or pointing runs (TPOINT, MMT). Rows are joined by the points' names, else in their order, else by
    time; files whose names differ are refused. Of a recording only the times at which the arm stands still are used.
    How every column is read is printed first. A unit that is stated nowhere is asked for on a terminal, and is an error
    elsewhere.
    """
    from armflex.intake.picture_files import board_of, is_pictures  # imports scipy

    board = None if board is None else board_of(board)
    if arm_path is not None and arm_path.resolve().parent != output.resolve().parent and any(map(is_pictures, paths)):
        raise InputError("--arm: write it to the folder of the campaign: both name files relative to themselves")
    taken = options.taken_in(
        paths,
        sigma,
        take,
        targets,
        joints=joints,
        sigma_r=sigma_r,
        dh=dh,
        board=board,
        on_arm=board_on_arm,
        tip=tip,
        beside=output.absolute().parent,
    )
    if arm_path is not None and taken.arm is None:
        raise InputError("--arm: no file is a URDF or has a table of DH parameters: columns theta, d, a, alpha")
    if taken.declare and arm_path is None:
        say("What reads the arm beside x y z is an instrument of its own. For the arm file:")
        for line in taken.declare.splitlines():
            say(line)
    with together():
        write_table(output, taken.columns)
        if arm_path is not None and taken.arm is not None:
            write_whole(arm_path, taken.arm.encode())
        unread = [{"pose": name, "line": line} for name, line in taken.without_point]
        content = {"joined": taken.joined, "taken": taken.taken, "notes": taken.notes, "without_point": unread}
        options.conclude(lambda: content, ())
    say_written(output, arm_path)
