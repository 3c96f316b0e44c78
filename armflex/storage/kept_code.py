"""Code that numba compiled, kept from one process to the next: what is wrong with where it is kept fails nothing.

numba finds a place that can be written, and code for each processor by itself. Its files are checked here before they
are used, since numba would end with whatever a damaged one makes of itself.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.serialize import dumps

log = logging.getLogger(__name__)


class _Checked(CompileResultCacheImpl):
    """Code with its digest: one wrong byte of it might be executed."""

    def reduce(self, cres: Any) -> tuple[bytes, bytes]:
        """Return the digest of what numba keeps, and that."""
        code = dumps(super().reduce(cres))
        return hashlib.sha256(code).digest(), code

    def rebuild(self, target_context: Any, payload: tuple[bytes, bytes]) -> Any:
        """Return what was compiled; raise ValueError where it is not what was kept."""
        digest, code = payload
        if hashlib.sha256(code).digest() != digest:
            raise ValueError("not what was written")
        return super().rebuild(target_context, pickle.loads(code))


class _Kept(FunctionCache):
    _impl_class = _Checked

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


def is_kept(function: Any) -> bool:
    """Return whether code of a function that is `kept` is there for this processor, for whatever arguments."""
    cache = function._cache
    try:
        return isinstance(cache, _Kept) and any(
            key[1] == function.targetctx.codegen().magic_tuple() for key in cache._cache_file._load_index()
        )
    except Exception:  # damaged, as `load_overload` will say
        return False


def kept(function: Any) -> Any:
    """Return a function of `numba.njit` whose code is kept; as it is, and that is said, where there is no place."""
    try:
        function._cache = _Kept(function.py_func)
    except RuntimeError as error:
        log.warning("compiled code cannot be kept: %s", error)
    return function
