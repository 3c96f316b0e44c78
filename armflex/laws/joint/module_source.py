"""Where the class of a `torch.nn.Module` stands: Python code of the user's own, which to load its law runs.

What was trained is known by the SHA-256 of the file that defines the class. Code that was changed since is refused,
for its weights may mean something else in it. The digest says nothing of who wrote the file, and nothing of what the
file imports: an arm whose laws name Python files is run, not read, and is to be taken from people who are trusted.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from armflex.errors import ArmflexError, InputError, Place, UnknownNameError


@dataclass(frozen=True)
class ModuleSource:
    """A class, or a function, that returns a module when it is called without arguments.

    Attributes:
        code: The Python file, absolute; or the dotted name of an installed module.
        name: Of the class in it.
        sha256: Of the file that defines it.
    """

    code: Path | str
    name: str
    sha256: str

    def __str__(self) -> str:
        return f"{self.code.name if isinstance(self.code, Path) else self.code}:{self.name}"

    def said(self, folder: Path) -> dict[str, str]:
        """Return what a law's file in a folder says of it: the file's path is relative to that, with slashes."""
        if isinstance(self.code, str):
            return {"package": self.code, "class": self.name, "sha256": self.sha256}
        try:
            code = Path(os.path.relpath(self.code, folder.resolve())).as_posix()
        except ValueError:  # on another drive
            code = self.code.as_posix()
        return {"file": code, "class": self.name, "sha256": self.sha256}

    def made(self) -> Any:
        """Return what the class gives when it is called; runs its code.

        Raises:
            InputError: The code cannot be read, is other code than was trained, fails, or has no such class.
        """
        content = _content(self.code)
        found = hashlib.sha256(content).hexdigest()
        if found != self.sha256:
            text = f"{self.code} has changed since the law was trained: its SHA-256 is {found[:12]}.., was"
            raise InputError(f"{text} {self.sha256[:12]}..; put it back as it was, or train the law anew")
        module = _run(self.code, content)
        make = getattr(module, self.name, None)
        if not callable(make):
            known = [name for name, value in vars(module).items() if callable(value) and not name.startswith("_")]
            raise UnknownNameError(f"class in {self.code}", self.name, known)
        return _guarded(self.code, make, f"{self.name}() fails; expected a class or function without arguments: ")


def module_source(text: str) -> ModuleSource:
    """Return the source that "FILE.py:CLASS" or "package.module:CLASS" names, relative to the working directory.

    Raises:
        InputError: The text is of another form, or the code is not there.
    """
    code, colon, name = text.rpartition(":")
    if not colon or not code or not name.isidentifier():
        raise InputError(f"module {text!r}: expected FILE.py:CLASS or package.module:CLASS")
    where: Path | str = Path(code).resolve() if code.endswith(".py") else code
    return ModuleSource(where, name, hashlib.sha256(_content(where)).hexdigest())


def _content(code: Path | str) -> bytes:
    """Return the Python code itself."""
    if isinstance(code, str):
        try:
            spec = find_spec(code)
        except (ImportError, ValueError) as error:
            raise InputError(f"no Python module {code!r}: {error}") from None
        if spec is None or not spec.origin or not spec.origin.endswith(".py"):
            text = "is not installed" if spec is None else "is not a Python file"
            raise InputError(f"Python module {code!r} {text}; a file of your own is named FILE.py:CLASS")
        code = Path(spec.origin)
    try:
        return code.read_bytes()
    except OSError as error:
        raise InputError(f"{code}: cannot be read: {error.strerror or error}") from None


def _run(code: Path | str, content: bytes) -> ModuleType:
    """Return the module that the code makes; a file's is known by what it holds, and is run once."""
    name = code if isinstance(code, str) else f"armflex_module_{hashlib.sha256(content).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    if isinstance(code, str):
        return _guarded(code, lambda: importlib.import_module(code))
    module = ModuleType(name)
    module.__file__ = str(code)
    sys.modules[name] = module  # dataclasses and annotations look for it there
    try:
        _guarded(code, lambda: exec(compile(content, str(code), "exec"), vars(module)))
    except ArmflexError:
        del sys.modules[name]
        raise
    return module


def _guarded(code: Path | str, run: Callable[[], Any], text: str = "") -> Any:
    """Return what a user's code gives; raise `InputError` with the file and line where it fails."""
    try:
        return run()
    except SyntaxError as error:
        place = Place(Path(error.filename or str(code)), error.lineno or 0)
        raise InputError(f"{place}: {error.msg}") from None
    except ArmflexError:
        raise
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(code)]
        place = Place(Path(code), lines[-1] or 0 if lines else 0) if isinstance(code, Path) else code
        raise InputError(f"{place}: {text}{type(error).__name__}: {error}") from None
