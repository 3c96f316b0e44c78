"""Which files of code may run: those whose digest the user has named, in this process or once for all.

An arm.toml and what it names are data, wherever they come from. Two kinds of files beside it are programs: the Python
file of a user's own torch module, and a xacro file that asks for more than its folder. Such a file is known by the
SHA-256 of what it holds. Whoever changes one letter of it has to be asked anew.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

import platformdirs

from armflex.errors import FileError, Place
from armflex.storage.read_file import read_file
from armflex.storage.whole_file import write_whole

DIGEST = re.compile("[0-9a-f]{64}")

MOST_BYTES = 500_000_000
"""Of a file whose digest is asked for: meshes are the largest."""

_named: ContextVar[frozenset[str]] = ContextVar("named", default=frozenset())

_own: set[str] = set()


def sha256_of(path: Path) -> str:
    """Return the digest of a file; raise `FileError` where it cannot be read."""
    try:
        return hashlib.sha256(read_file(path, MOST_BYTES)).hexdigest()
    except OSError as error:
        raise FileError(Place(path), f"cannot be read: {error.strerror or error}") from None


def trusted_list() -> Path:
    """Return the file in the user's configuration that keeps what is trusted, whether it is there or not."""
    return platformdirs.user_config_path("armflex", appauthor=False) / "trusted.sha256"


def trusted_files() -> dict[str, str]:
    """Return the files that are trusted once for all, by digest: where each stood; raise `FileError` on damage."""
    path = trusted_list()
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise FileError(Place(path), f"cannot be read: {error}") from None
    found = dict[str, str]()
    for number, line in enumerate(lines, 1):
        digest, _, name = line.partition("  ")
        if not DIGEST.fullmatch(digest) or not name:
            raise FileError(
                Place(path, number), "expected a SHA-256, two blanks and a file's name, as sha256sum has it"
            )
        found[digest] = name
    return found


def keep_trusted(files: dict[str, str]) -> None:
    """Write which files are trusted once for all, by digest; raise `FileError` where that is not possible."""
    path = trusted_list()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(Place(path), f"cannot be written: {error.strerror or error}") from None
    write_whole(path, "".join(f"{digest}  {name}\n" for digest, name in files.items()).encode())


@contextmanager
def trusting(trust: Sequence[str | Path] | str | Path) -> Iterator[None]:
    """Trust files, or digests, while the block lasts; raise `FileError` where a file cannot be read."""
    several = [trust] if isinstance(trust, str | Path) else trust
    digests = {one if DIGEST.fullmatch(str(one)) else sha256_of(Path(one)) for one in several}
    begun = _named.set(_named.get() | {str(one) for one in digests})
    try:
        yield
    finally:
        _named.reset(begun)


def take_as_own(digest: str) -> None:
    """Trust code in this process, for its user has just asked for it to be run, as `train` does."""
    _own.add(digest)


def is_trusted(digest: str) -> bool:
    """Return whether code of a digest may run."""
    return digest in _own or digest in _named.get() or digest in trusted_files()
