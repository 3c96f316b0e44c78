"""Code that numba compiled, kept from one process to the next: what is wrong with where it is kept fails nothing.

numba finds a place that can be written, and code for each processor by itself. numba looks at the function's own file
only; here all that it is compiled from counts, see `sources`. Code of other sources is written over where its name is
the same; a file whose function has another name now stays, unused. Files are checked before they are used, since numba
would end with whatever a damaged one makes of itself.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.core.typing.templates import builtin_registry

from armflex.progress import interlude

log = logging.getLogger(__name__)

WAITED = 10.0
"""Tolerance: seconds after which a process compiles beside another one that still does: alone it takes a minute."""

COUNTS = "argcount", "posonlyargcount", "kwonlyargcount", "flags"
CODE = *COUNTS, "code", "consts", "names", "varnames", "freevars", "cellvars", "exceptiontable"
"""What is read of a code object: neither its lines nor where its file is."""


def sources(function: Dispatcher) -> bytes:
    """Return a digest of all that a function is compiled from, as it is in memory: its file may be another by now.

    That is its code, its options, and the values of its names: numbers, arrays, and the fields of named tuples.
    Compiled functions among these count likewise, as do others of the package and what their closures hold; and the
    overloads in the modules of all these, since those of operators have no name. Libraries count by name.
    """
    reached, modules, found = list[Any]([function]), list[str](), hashlib.sha256()
    package = function.py_func.__module__.partition(".")[0]

    def text(value: Any) -> str:
        """Return what is the same in every process; what else has code is `reached`, to be read in its turn."""
        if isinstance(value, CodeType):
            return text(tuple(getattr(value, f"co_{name}", None) for name in CODE))
        if isinstance(value, tuple):
            return f"{type(value).__qualname__}({','.join(map(text, value))})"
        if isinstance(value, set | frozenset):
            return f"{{{','.join(sorted(map(text, value)))}}}"
        if isinstance(value, np.ndarray):
            return f"{value.dtype}{value.shape}{value.tobytes()!r}"
        if isinstance(value, ModuleType):
            return value.__name__
        own = isinstance(value, FunctionType) and value.__module__.partition(".")[0] == package
        if (own or isinstance(value, Dispatcher | _Intrinsic)) and all(value is not one for one in reached):
            reached.append(value)
        if hasattr(value, "__qualname__"):
            fields = getattr(value, "_fields", ()), getattr(value, "_field_defaults", {})
            return f"{value.__module__}.{value.__qualname__}{text(fields) if isinstance(value, type) else ''}"
        return f"{type(value).__qualname__} {value!r}"

    for one in reached:
        plain: Any = getattr(one, "py_func", getattr(one, "_defn", one))
        codes = [plain.__code__]
        for code in codes:
            codes += [part for part in code.co_consts if isinstance(part, CodeType)]
        names = sorted({name for code in codes for name in code.co_names})
        inside = [cell.cell_contents for cell in plain.__closure__ or ()]
        options = sorted(getattr(one, "targetoptions", {}).items())
        values = [(name, plain.__globals__[name]) for name in names if name in plain.__globals__]
        opened = list[ModuleType]()
        for name, value in values:
            if isinstance(value, ModuleType) and value.__name__.partition(".")[0] == package and value not in opened:
                opened.append(value)
                values += [(f"{name}.{part}", vars(value)[part]) for part in names if part in vars(value)]
        made = plain.__code__, plain.__defaults__, plain.__kwdefaults__, *inside, *options, *values
        found.update(f"{plain.__module__}.{plain.__qualname__} = {text(made)}\n".encode())
        for template in builtin_registry.functions if plain.__module__ not in modules else ():
            overload = getattr(template, "_overload_func", None)
            if getattr(overload, "__module__", None) == plain.__module__:
                found.update(f"{text(template.key)} = {text(overload)}\n".encode())
        modules.append(plain.__module__)
    return found.digest()


class _Checked(CompileResultCacheImpl):
    """Code with its digest: one wrong byte of it might be executed."""

    function: Any

    @cached_property
    def sources(self) -> bytes:
        """See `sources`: asked for at first use, when the module is there as a whole."""
        return sources(self.function)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return the name without the line of the function, so that a file of other sources is written over."""
        return f"{fullname.replace('<', '').replace('>', '')}.{sys.implementation.cache_tag}{abiflags}"

    def reduce(self, cres: Any) -> tuple[bytes, bytes]:
        """Return the digest of sources and of what numba keeps, and that."""
        code = dumps(super().reduce(cres))
        return hashlib.sha256(self.sources + code).digest(), code

    def rebuild(self, target_context: Any, payload: tuple[bytes, bytes]) -> Any:
        """Return what was compiled; raise ValueError where it is not what was kept."""
        digest, code = payload
        if hashlib.sha256(self.sources + code).digest() != digest:
            raise ValueError("not what was written")
        return super().rebuild(target_context, pickle.loads(code))


class _Kept(FunctionCache):
    _impl_class = _Checked

    def __init__(self, function: Dispatcher) -> None:
        super().__init__(function.py_func)
        self._impl.function = function
        del self._cache_file  # whose stamp is that of one file

    @cached_property
    def _cache_file(self) -> IndexDataCacheFile:
        return IndexDataCacheFile(self.cache_path, self._impl.filename_base, self._impl.sources)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return kept code, None where there is none or it is damaged: then it is cleared."""
        try:
            found = super().load_overload(sig, target_context)
            if found is None or found.signature.args == tuple(normalize_signature(sig)[0]):
                return found
            why = "code for other arguments, as two processes leave it that write at once"
        except Exception as error:  # what a damaged file raises may be anything
            why = f"{type(error).__name__}: {error}"
        log.warning("compiled code in %s is damaged, and is compiled again (%s)", self.cache_path, why)
        try:
            self.flush()
        except OSError as error:
            log.warning("%s: cannot be cleared: %s", self.cache_path, error.strerror)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep code where that can be written; what cannot be kept is compiled in every process."""
        try:
            super().save_overload(sig, data)
        except Exception as error:  # from a full disk to an index that another process has damaged since
            why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
            log.warning("%s: compiled code cannot be kept there: %s", self.cache_path, why)


def is_kept(*functions: Any) -> bool:
    """Return whether code of all functions that are `kept` is there for this processor, for whatever arguments."""
    try:
        return all(
            isinstance(one._cache, _Kept)
            and any(key[1] == one.targetctx.codegen().magic_tuple() for key in one._cache._cache_file._load_index())
            for one in functions
        )
    except Exception:  # damaged, as `load_overload` will say
        return False


@contextmanager
def compiled_once(*functions: Any) -> Iterator[None]:
    """Let one process at a time compile some functions that are `kept`: the others wait, and then read what it kept.

    Nobody waits for what is kept already, for a process that ended, where nothing can be kept, or beyond `WAITED`.
    """
    cache = functions[0]._cache
    if is_kept(*functions) or not isinstance(cache, _Kept):
        yield
        return
    lock = FileLock(Path(cache.cache_path) / f"{functions[0].__name__}.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        waiting = f"another process compiles: waiting for it, {WAITED:g} s at most"
        log.warning(waiting)
        with interlude(waiting), suppress(Timeout):
            lock.acquire(timeout=WAITED)
    except (OSError, NotImplementedError):  # read-only, or without locks
        pass
    try:
        yield
    finally:
        lock.release()


def kept(function: Any) -> Any:
    """Return a function of `numba.njit` whose code is kept; as it is, and that is said, where there is no place."""
    try:
        function._cache = _Kept(function)
    except (RuntimeError, OSError, ValueError) as error:  # no place, or no file to look at
        log.warning("compiled code cannot be kept: %s", error)
    return function
