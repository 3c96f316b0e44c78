"""armflex compile: the engine, before a long job asks for it."""

from __future__ import annotations

from collections import deque

import click

from armflex.cli import options
from armflex.cli.terminal import complain, doing, say
from armflex.mechanics.many_rows import compilations, is_kept
from armflex.parallel import in_order


@click.command(cls=options.Command)
def command() -> None:
    """Compile the engine now instead of with the first long job: about a minute, once for each machine and version.

    Small jobs are answered without it.
    """
    doing("compiling the engine for this machine")
    deque(in_order(compilations(), jobs=2), 0)
    options.conclude(lambda: {"compiled": True}, ())
    if is_kept():
        say("The engine is compiled, and its code is kept.")
    else:
        complain(
            "The engine is compiled, but its code is not kept: NUMBA_CACHE_DIR may name a place that can be written."
        )
