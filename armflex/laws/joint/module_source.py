"""Where the class of a `torch.nn.Module` stands: a Python file of the user's own, which to load its law runs.

What was trained is known by the SHA-256 of the file. Code that was changed since is refused, for its weights may mean
something else in it, and so is code that the user has not trusted, see `storage.trust`: the digest says nothing of who
wrote the file. Nor does it say anything of what the file imports.
"""

from __future__ import annotations

import hashlib
import os
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from armflex.errors import ArmflexError, InputError, Place, UnknownNameError, UntrustedError
from armflex.storage.trust import is_trusted, sha256_of, take_as_own


@dataclass(frozen=True)
class ModuleSource:
    """A class, or a function, that returns a module when it is called without arguments.

    Attributes:
        code: The Python file, absolute.
        name: Of the class in it.
        sha256: Of the file.
    """

    code: Path
    name: str
    sha256: str

    def __str__(self) -> str:
        return f"{self.code.name}:{self.name}"

    def said(self, folder: Path) -> dict[str, str]:
        """Return what a law's file in a folder says of it: the file's path is relative to that, with slashes."""
        try:
            code = Path(os.path.relpath(self.code, folder.resolve())).as_posix()
        except ValueError:  # on another drive
            code = self.code.as_posix()
        return {"file": code, "class": self.name, "sha256": self.sha256}

    def check(self) -> None:
        """Raise `InputError` where the code is not there or has changed, `UntrustedError` where it may not run."""
        found = sha256_of(self.code)
        if found != self.sha256:
            text = f"{self.code} has changed since the law was trained: its SHA-256 is {found[:12]}.., was"
            raise InputError(f"{text} {self.sha256[:12]}..; put it back as it was, or train the law anew")
        if not is_trusted(found):
            raise UntrustedError(Place(self.code), "is Python code that a law runs", found)

    def made(self) -> Any:
        """Return what the class gives when it is called; runs its code.

        Raises:
            InputError: The code cannot be read, is other code than was trained, fails, or has no such class.
        """
        module = _run(self.code, self.sha256)
        make = getattr(module, self.name, None)
        if not callable(make):
            known = [name for name, value in vars(module).items() if callable(value) and not name.startswith("_")]
            raise UnknownNameError(f"class in {self.code}", self.name, known)
        return _guarded(self.code, make, f"{self.name}() fails; expected a class or function without arguments: ")


def module_source(text: str) -> ModuleSource:
    """Return the source that a user's "FILE.py:CLASS" names, relative to the working directory, and trust it.

    Raises:
        InputError: The text is of another form, or the code is not there.
    """
    code, colon, name = text.rpartition(":")
    if not colon or not code.endswith(".py") or not name.isidentifier():
        raise InputError(f"module {text!r}: expected FILE.py:CLASS")
    path = Path(code).resolve()
    take_as_own(digest := sha256_of(path))
    return ModuleSource(path, name, digest)


def _run(code: Path, sha256: str) -> ModuleType:
    """Return the module that a file of this digest makes; it is known by what it holds, and is run once."""
    name = f"armflex_module_{sha256}"
    if name in sys.modules:
        return sys.modules[name]
    content = code.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(f"{code} has changed since it was looked at")
    module = ModuleType(name)
    module.__file__ = str(code)
    sys.modules[name] = module  # dataclasses and annotations look for it there
    try:
        _guarded(code, lambda: exec(compile(content, str(code), "exec"), vars(module)))
    except ArmflexError:
        del sys.modules[name]
        raise
    return module


def _guarded(code: Path, run: Callable[[], Any], text: str = "") -> Any:
    """Return what a user's code gives; raise `InputError` with the file and line where it fails."""
    try:
        return run()
    except SyntaxError as error:
        raise InputError(f"{Place(Path(error.filename or code), error.lineno or 0)}: {error.msg}") from None
    except ArmflexError:
        raise
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(code)]
        place = Place(code, lines[-1] or 0 if lines else 0)
        raise InputError(f"{place}: {text}{type(error).__name__}: {error}") from None
