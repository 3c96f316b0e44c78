"""armflex trust: which files may run as programs."""

from __future__ import annotations

from pathlib import Path

import click

from armflex.cli import options
from armflex.cli.terminal import say
from armflex.errors import InputError
from armflex.storage.trust import keep_trusted, sha256_of, trusted_files, trusted_list
from armflex.storage.whole_file import together


@click.command(cls=options.Command)
@click.argument("files", metavar="[FILE.py]...", nargs=-1, type=options.InputPath)
@click.option("--list", "listed", is_flag=True, help="Show what is trusted.")
@click.option("--forget", is_flag=True, help="Trust the files no longer, each given by its name or its SHA-256.")
def command(files: tuple[Path, ...], listed: bool, forget: bool) -> None:
    """Trust files that are programs: the Python file of a torch law, a xacro file that reads beyond its folder.

    Read them first: they do what they like. What is trusted is what a file holds now, wherever it lies; a changed file
    has to be trusted anew. The list is kept in your configuration.
    """
    if not files and not listed:
        raise InputError("trust which file? armflex trust FILE.py; --list shows what is trusted")
    known = trusted_files()
    before = dict(known)
    for path in files:
        if not forget:
            if path.suffix not in (".py", ".xacro"):
                raise InputError(f"{path}: expected a Python or a xacro file, others are no programs")
            known[sha256_of(path)] = str(path.absolute())
            continue
        gone = [digest for digest, name in known.items() if str(path) == digest or str(path.absolute()) == name]
        for digest in gone or [sha256_of(path)]:
            if known.pop(digest, None) is None:
                raise InputError(f"{path} is not trusted: there is nothing to forget")
    with together():
        if known != before:
            keep_trusted(known)
        options.write_json(
            {
                "format": "armflex-trust-1",
                "files": [{"file": name, "sha256": digest} for digest, name in known.items()],
            }
        )
    if listed:
        say(f"Trusted, in {trusted_list()}:")
        say(*(line for digest, name in known.items() for line in (name, f"  SHA-256 {digest}")))
    else:
        say(*(f"{'Forgotten' if forget else 'Trusted'}: {path}" for path in files))
