"""`armflex`: finds the command, words every failure, and sets the exit code.

0: fine. 1: a checked thing failed (a tolerance, a path, an equilibrium). 2: bad input.
"""

import importlib
import io
import os
import signal
import sys
import warnings
from types import ModuleType
from typing import NoReturn

import click

COMMANDS = {
    "deflect": "loads, local deflections and the tip's displacement at one configuration",
    "modes": "natural frequencies and mode shapes at one configuration",
    "predict": "the tip's position for every row of a table",
    "check": "compare a loaded path with a tolerance, or a compensated path with the intended one",
    "compensate": "joint positions that put the deflected tip where the rigid arm would be",
    "intake": "join a tracker's export and a controller's log into one campaign",
    "calibrate": "fit what [prior] frees to a measured campaign",
    "trace": "calibrate, and find the effects that explain the residual",
    "prior": "write what sister arms have in common as the prior of the next one",
    "history": "what changed in one machine between its calibrations, and when",
    "report": "pose accuracy and repeatability of a campaign, as ISO 9283 defines them",
    "plan": "the poses, payloads and approach directions to measure next",
    "rehearse": "which missing effects a campaign would name, before it is driven",
    "train": "learn a joint deformation model from loads and deflections",
    "fem": "condense a mesh to stiffness, mass and weight where it joins its neighbours",
    "map": "worst displacement, uncertainty and margin over the whole workspace",
    "export": "write the arm for other programs: URDF, a sheet for the controller, C, URScript, KRL, RAPID",
    "view": "write a page of the arm that opens in a browser",
    "schema": "the JSON schemas of an arm.toml and of what --json writes",
    "demo": "the whole workflow on the bundled TARM-like arm",
}

GONE = {
    "trust": "an arm file runs no code",
    "compile": "leave it out; the engine comes compiled with the package",
    "--resume": "leave it out; --minutes N gives a search the time that it needs",
    "--store": "leave it out; a map of the default size takes seconds",
    "--chunk": "leave it out",
}
"""Command or option of an earlier version -> what to do instead."""

THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""What the libraries behind SciPy, which no command has loaded yet, ask for their number of threads. The matrices here
are so small that threads wait for each other rather than work, on a busy machine a hundred times as long as one takes.
"""

ENDING = (signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))
"""Signals that end a command as Ctrl-C does."""

ASKS_FOR_HELP = getattr(click.exceptions, "NoArgsIsHelpError", ())
"""What click 8.2 and later raise where nothing is asked; 8.1 shows the help by itself."""


class Commands(click.Group):
    """Loads a command's module only when it is asked for, so that `--help` is quick."""

    def list_commands(self, context: click.Context) -> list[str]:
        """Return the commands in reading order."""
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Return a command, or None when there is none of that name."""
        if name not in COMMANDS:
            return None
        return importlib.import_module(f"armflex.cli.{name}_command").command

    def resolve_command(self, context: click.Context, args: list[str]) -> tuple:
        """Find the command; name the nearest one where there is none."""
        if args[0] in GONE:
            context.fail(f"{args[0]} is no more: {GONE[args[0]]}")
        if args[0] not in COMMANDS:
            from armflex.errors import did_you_mean

            context.fail(f"no command {args[0]!r}{did_you_mean(args[0], COMMANDS)} (known: {', '.join(COMMANDS)})")
        return super().resolve_command(context, args)

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Begin with `armflex demo`, or with an arm.toml of your own: `armflex deflect --help` says what it is. "
    "Measured it? `calibrate`, then `trace`. A path? `check`, `compensate`, `check --against`, `export`.",
)
@click.version_option(package_name="armflex")
def armflex() -> None:
    """Manipulators that sag: joint compliance, end-effector deflection, path checks and compensation."""


def main() -> None:
    """Run the command line; exit with 0, 1 or 2."""
    _open_streams()
    for number in ENDING:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)
    warnings.showwarning = lambda message, *_, **__: _terminal().warn(str(message))
    for name in THREADS:
        os.environ.setdefault(name, "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that has no ± shows ? instead of a traceback
    try:
        code = armflex.main(standalone_mode=False)
    except ASKS_FOR_HELP as error:
        error.show()
        sys.exit(2)
    except Exception as error:
        if isinstance(error, click.exceptions.Abort) or _was_interrupted(error):
            if _ended:
                _fail(f"ended by {signal.Signals(_ended[-1]).name}", 128 + _ended[-1])
            _fail("interrupted", 130)
        _fail(*_said_of(error))
    _flush()
    sys.exit(code if isinstance(code, int) else 0)


def _said_of(error: Exception) -> tuple[str | tuple[str, ...], int]:
    """Return what is said of an error, and the exit code; raise one that nobody foresaw."""
    from armflex.errors import ArmflexError, InputError
    from armflex.plugins import blamed

    match error:
        case click.NoSuchOption(option_name=name) if name in GONE:
            return f"{name} is no more: {GONE[name]}{_read_on(error)}", 2
        case click.ClickException():  # worded as everything else is: one line, and where to read on
            text = " ".join(error.format_message().split()).rstrip(".")
            return text[:1].lower() + text[1:] + _read_on(error), 2
        case MemoryError():
            return "there is not enough memory for this", 1
        case BrokenPipeError():  # nobody reads on, as `head` does
            _terminal().nobody_reads(1)
            sys.exit(0)
        case OSError():
            return f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}", 2
        case ArmflexError():
            return getattr(error, "problems", str(error)), 2 if isinstance(error, InputError) else 1
    if where := blamed(error):
        return f"{where}: {type(error).__name__}: {error}", 2
    raise error


def _read_on(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return f" (see {context.command_path} --help)" if context else ""


def _open_streams() -> None:
    """Open the streams that are closed, as of a service, on nothing: the next file would get their numbers."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            nothing = os.open(os.devnull, os.O_RDWR)
            if nothing != number:
                os.dup2(nothing, number)
                os.close(nothing)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _flush() -> None:
    """Write what is left on stdout, nowhere if nobody reads it: Python would complain of that at its very end."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _terminal().nobody_reads(1)


_ended: list[int] = []


def _end(number: int, frame: object) -> NoReturn:
    """End as Ctrl-C does: with what there is, and without a file that is written in part."""
    _ended.append(number)
    raise KeyboardInterrupt


def _was_interrupted(error: BaseException | None) -> bool:
    """Return whether Ctrl-C is behind an error: libraries that tidy up after it may fail, and raise that instead."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _fail(text: str | tuple[str, ...], code: int) -> NoReturn:
    for line in (text,) if isinstance(text, str) else text:
        _terminal().complain(f"error: {line}")
    sys.exit(code)


def _terminal() -> ModuleType:
    from armflex.cli import terminal  # imports rich

    return terminal


if __name__ == "__main__":
    main()
