"""[requires] in an arm.toml: distributions whose effects, laws and readings it needs, each with a version."""

from collections.abc import Iterator, Mapping
from typing import Any

from armflex.declaration import Declaration
from armflex.laws import LAWS
from armflex.laws.effects import CATALOGUE
from armflex.plugins import Distribution, missing
from armflex.readings import SENSOR_KINDS


def check_requires(table: Declaration) -> None:
    """Raise `ArmFileError` at the first distribution that is not installed, or not in the version that is needed."""
    for name in table.table:
        try:
            problem = missing(name, table.text(name))
        except ValueError as error:
            raise table.fail(name, str(error)) from None
        if problem:
            raise table.fail(name, problem)


def requires_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the least version, as installed, of every distribution that the names in an arm.toml's tables are of."""
    return {owner.name: f">={owner.version}" for owner in _owners(document) if owner is not None}


def _owners(document: Mapping[str, Any]) -> Iterator[Distribution | None]:
    for effect in document.get("effect", ()):
        yield CATALOGUE.distribution(effect["name"])
    for instrument in document.get("instrument", {}).values():
        yield SENSOR_KINDS.distribution(instrument["kind"])
    tables = [document.get("flexure", {}), *(preset["flexure"] for preset in document.get("preset", {}).values())]
    for flexure in (flexure for flexures in tables for flexure in flexures.values()):
        for part in (flexure, *flexure.get("subjoint", ())):
            yield LAWS.distribution(part.get("model", "linear"))
