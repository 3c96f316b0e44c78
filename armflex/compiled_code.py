"""Modules that numba compiles, where it is installed: `pip install armflex[fast]`."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType


@cache
def compiled_code(module: str) -> ModuleType | None:
    """Return a module by name where numba is installed and finds a place to keep its code, else None."""
    try:
        return import_module(module)
    except (ImportError, RuntimeError):
        return None
