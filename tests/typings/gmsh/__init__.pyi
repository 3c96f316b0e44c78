# gmsh is the user's to install (GPL), and has no types of its own.
from typing import Any

def __getattr__(name: str) -> Any: ...
