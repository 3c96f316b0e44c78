"""armflex compile: the engine, before a long job asks for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from types import ModuleType

import click

from armflex.cli import options
from armflex.cli.terminal import doing, say
from armflex.mechanics.many_rows import kernel_of_one_row, tree_kernel
from armflex.parallel import in_order


@click.command(cls=options.Command)
def command() -> None:
    """Compile the engine now instead of with the first long job: about a minute, once for each machine and version.

    Small jobs are answered without it.
    """
    doing("compiling")
    deque(in_order((partial(_made, engine) for engine in (kernel_of_one_row, tree_kernel)), jobs=2), 0)
    options.conclude(lambda: {"compiled": True}, ())
    say("The engine is compiled, and its code is kept.")


def _made(engine: Callable[[], ModuleType]) -> None:
    """Compile an engine; the module itself stays in its process."""
    engine()
