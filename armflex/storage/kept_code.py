"""Code that numba compiled, kept from one process to the next: what is wrong with where it is kept fails nothing.

numba finds a place that can be written, and code for each processor by itself. It takes code for that of the sources
as they are where the function's own file did not change; here it is all that the function is compiled from, see
`_sources`. What is kept of other sources is written over, so nothing is left behind. Files are checked before they are
used, since numba would end with whatever a damaged one makes of itself.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
import pickle
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

from filelock import FileLock, Timeout
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

log = logging.getLogger(__name__)

WAITED = 600.0
"""Tolerance: seconds after which a process compiles beside another one that still does."""


@cache
def _sources(module: ModuleType) -> bytes:
    """Return a digest of all that a module's functions are compiled from.

    That is its text and that of each module with a compiled function among its names, of theirs likewise, and what is
    built in from others by value: numbers, and the fields of named tuples. What these hold of other code is not built
    in, so a change there compiles nothing anew.
    """
    modules, found = [module], hashlib.sha256()
    for one in modules:
        found.update(inspect.getsource(one).encode())
        for name, value in sorted(vars(one).items()):
            if isinstance(value, Dispatcher):
                other = sys.modules[value.py_func.__module__]
                modules += [other] if other not in modules else []
            elif isinstance(value, int | float) or (isinstance(value, tuple) and set(map(type, value)) <= {int, float}):
                found.update(f"{name} = {value!r}".encode())
            elif isinstance(value, type) and issubclass(value, tuple):
                found.update(f"{name}{getattr(value, '_fields', ())}".encode())
    return found.digest()


class _Checked(CompileResultCacheImpl):
    """Code with its digest: one wrong byte of it might be executed."""

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        self._module = sys.modules[py_func.__module__]

    @property
    def sources(self) -> bytes:
        """See `_sources`: asked for at first use, when the module is there as a whole."""
        return _sources(self._module)

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

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        del self._cache_file  # whose stamp is that of one file

    @cached_property
    def _cache_file(self) -> IndexDataCacheFile:
        return IndexDataCacheFile(self.cache_path, self._impl.filename_base, self._impl.sources)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return kept code, None where there is none or it is damaged: then it is cleared."""
        try:
            return super().load_overload(sig, target_context)
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
        except OSError as error:
            log.warning("%s: compiled code cannot be kept there: %s", self.cache_path, error.strerror)


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
        log.warning("another process compiles: waiting for it")
        with suppress(Timeout):
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
        function._cache = _Kept(function.py_func)
    except RuntimeError as error:
        log.warning("compiled code cannot be kept: %s", error)
    return function
