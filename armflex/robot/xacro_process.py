"""Expands a xacro file in a process of its own, which `armflex.robot.formats` starts; it imports nothing of armflex.

xacro evaluates Python expressions. This process has so much time and memory and writes no file. An expression reaches
what a robot needs: numbers, texts, and files below the file's folder or a package that it names. Attributes that lead
into the interpreter are refused, and beneath that all calls of the system. An attack on Python itself may get through.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

LIBRARIES = ("xacrodoc", "xacro")

SECONDS, PATIENCE, MEMORY, MOST_BYTES = 8, 60, 1 << 30, 64_000_000
"""Of a processor; by the clock; bytes of this process; bytes that a robot becomes. Real robots take two seconds."""

FAILED, REFUSED = 3, 4
"""Exit codes: the file is wrong, or asks for more than it may; what there is to say comes instead of the robot."""

INSIDE = ("gi_frame", "gi_code", "gi_yieldfrom", "f_back", "f_builtins", "f_code", "f_globals", "f_locals", "mro")
"""Attributes that lead into the interpreter, beside those that begin with an underscore."""

REACHING = ("os.", "shutil.", "subprocess.", "socket.", "ctypes.", "tempfile.", "urllib.", "pty.", "mmap.", "winreg.")
"""Of Python's audit events, those that leave this process; of `os` two are harmless."""


class Refused(BaseException):
    """The file asks for more than it may. Not an `Exception`: a library must not turn it into another one."""


def main() -> None:
    """Write the robot that a xacro file stands for to the standard output, or what is wrong."""
    name, trusted = sys.argv[1], sys.argv[2] == "trusted"
    out, sys.stdout = sys.stdout, sys.stderr  # which is the libraries' own
    sys.dont_write_bytecode = True
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    except (ImportError, ValueError, OSError):
        pass  # Windows: the time is limited by who waits
    code, library = 0, LIBRARIES[0]
    try:
        try:
            found: Any = import_module(library)
        except ImportError:
            found = import_module(library := LIBRARIES[1])
        if not trusted:
            confine(Path(name).resolve().parent)
        said = (
            found.process_file(name).toxml() if library == "xacro" else found.XacroDoc.from_file(name).to_urdf_string()
        )
        if len(said) > MOST_BYTES:
            raise ValueError(f"it becomes {len(said)} bytes, more than the {MOST_BYTES} allowed")
    except Refused as error:
        code, said = REFUSED, str(error)
    except (Exception, SystemExit) as error:  # every fault of the file, of whatever kind
        kind = type(getattr(error, "exc", None) or error).__name__
        code, said = FAILED, f"{library} cannot expand it: {kind}: {' '.join(str(error).split())}"
    out.buffer.write(said.encode("utf-8", "replace"))
    out.flush()
    os._exit(code)  # at once: nothing is to be tidied up, and some of that would be refused


def confine(folder: Path) -> None:
    """Refuse from now on what no robot needs: files elsewhere than below a folder and named packages, and more."""
    xacro: Any = import_module("xacro")
    substitutions: Any = import_module("xacro.substitution_args")
    roots, looking = [os.path.realpath(folder)], list[str]()
    own = [os.path.realpath(path) for path in sys.path if path]  # modules that are imported only now

    def named(find: Callable[[str], str]) -> Callable[[str], str]:
        def found(package: str) -> str:
            if not re.fullmatch(r"[\w-]+", package):
                raise Refused(f"names a package {package!r}")
            looking.append(package)
            try:
                place = find(package)
            finally:
                looking.pop()
            roots.append(os.path.realpath(place))
            return place

        return found

    def refuse(what: str) -> Callable[..., Any]:
        def refused(*given: Any, **more: Any) -> None:
            raise Refused(what.format(*given))

        return refused

    packages: Any = sys.modules.get("xacrodoc.packages")
    if packages is not None:
        packages.get_path = named(packages.get_path)  # which is asked for meshes, too
    else:
        substitutions._eval_find = named(substitutions._eval_find)
    substitutions._eval_env = substitutions._eval_optenv = refuse("reads the environment variable {0!r}")
    substitutions._eval = refuse("evaluates $({0})")
    evaluate = xacro.safe_eval

    def harmless(expression: str, *given: Any) -> Any:
        for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
            word = getattr(node, "attr", getattr(node, "id", ""))
            if word.startswith("_" if isinstance(node, ast.Attribute) else "__") or word in INSIDE:
                raise Refused(f"evaluates {expression.strip()!r}, whose {word!r} leads into Python itself")
        return evaluate(expression, *given)

    xacro.safe_eval = harmless
    for name in ("type", "vars"):
        dict.pop(xacro._global_symbols["python"], name, None)
    import_module("yaml")

    def watch(event: str, given: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(given[0], str | bytes) and not looking:
            path, writes = os.path.realpath(os.fsdecode(given[0])), given[2] & (os.O_WRONLY | os.O_RDWR)
            if writes or not any(Path(path).is_relative_to(root) for root in (*roots, *own)):
                raise Refused(f"opens {os.fsdecode(given[0])}, which is not below its folder or a package it names")
        elif event.startswith(REACHING) and event not in ("os.listdir", "os.scandir"):
            raise Refused(f"asks the system for {event}")

    sys.addaudithook(watch)


if __name__ == "__main__":
    main()
