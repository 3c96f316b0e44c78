"""armflex schema: what an arm.toml and the files of --json hold, for editors and programs."""

import json

import click

from armflex.cli.terminal import say, say_file
from armflex.errors import UnknownNameError
from armflex.schemas import read_schema, schema_names


@click.command()
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the JSON schemas, or print the one called NAME.

    An arm.toml's is `arm`. A file of --json has the name of its schema under "format".
    """
    names = schema_names()
    if name is None:
        say(*names)
        return
    full = name if name in names else f"armflex-{name}-1"
    if full not in names:
        raise UnknownNameError("schema", name, [schema.removeprefix("armflex-").removesuffix("-1") for schema in names])
    say_file(json.dumps(read_schema(full), indent=1))
