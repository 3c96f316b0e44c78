"""Expands a xacro file in a process of its own, which `armflex.robot.formats` starts; it imports nothing of armflex.

xacro evaluates Python expressions. This process has so much time and memory and writes no file. An expression reaches
what a robot needs: numbers, texts, and files below the file's folder or a package that it names. Attributes that lead
into the interpreter are refused, and beneath that all calls of the system. An attack on Python itself may get through.
"""

import ast
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

LIBRARY = "xacro"
"""What expands; xacrodoc brings it along."""

SECONDS, PATIENCE, MEMORY, MOST_BYTES = 8, 60, 1 << 30, 64_000_000
"""Of a processor; by the clock; bytes of this process; bytes that a robot becomes. Real robots take two seconds."""

DEEPEST = 5
"""Folders below one of ROS_PACKAGE_PATH in which a package is looked for."""

FAILED, REFUSED = 3, 4
"""Exit codes: the file is wrong, or asks for more than it may; what there is to say comes instead of the robot."""

INSIDE = ("gi_frame", "gi_code", "gi_yieldfrom", "f_back", "f_builtins", "f_code", "f_globals", "f_locals", "mro")
"""Attributes that lead into the interpreter, beside those that begin with an underscore."""

REACHING = ("os.", "shutil.", "subprocess.", "socket.", "ctypes.", "tempfile.", "urllib.", "pty.", "mmap.", "winreg.")
"""Of Python's audit events, those that leave this process; of `os` two are harmless."""


class Refused(BaseException):
    """The file asks for more than it may. Not an `Exception`: a library must not turn it into another one."""


def main() -> None:
    """Write the robot that a xacro file stands for to the standard output, or what is wrong.

    The command line has the file's name, and `name:=value` of each argument.
    """
    name = sys.argv[1]
    given = _Arguments(text.split(":=", 1) for text in sys.argv[2:])
    out, sys.stdout = sys.stdout, sys.stderr  # which is the libraries' own
    sys.dont_write_bytecode = True
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    except (ImportError, ValueError, OSError):
        pass  # Windows: the time is limited by who waits
    code = 0
    try:
        xacro: Any = import_module(LIBRARY)
        find = partial(find_package, Path(name).resolve().parent)
        substitutions: Any = import_module("xacro.substitution_args")
        substitutions._eval_find = find
        substitutions._eval_dirname = lambda _: os.path.abspath(
            os.path.dirname((xacro.filestack or [name])[-1] or name)
        )
        find = confine(Path(name).resolve().parent, find)
        checked = xacro.check_attrs

        def check(tag: Any, required: Sequence[str], optional: Sequence[str]) -> Any:
            if tag.tagName == "xacro:arg" and not tag.hasAttribute("default"):  # which xacro itself demands
                if tag.getAttribute("name") not in given:
                    raise ArgumentError(f"its argument {tag.getAttribute('name')!r} has no value")
                tag.setAttribute("default", "")
            return checked(tag, required, optional)

        xacro.check_attrs = check
        document = xacro.process_file(name, mappings=given)
        if unknown := [argument for argument in sys.argv[2:] if argument.split(":=", 1)[0] not in given.asked]:
            names = ", ".join(sorted(given.asked)) or "none"
            raise ArgumentError(f"it has no argument {unknown[0].split(':=', 1)[0]!r} (known: {names})")
        said = re.sub(r"package://([\w-]+)", partial(_file_of, find), document.toxml())
        if len(said) > MOST_BYTES:
            raise ValueError(f"it becomes {len(said)} bytes, more than the {MOST_BYTES} allowed")
    except Refused as error:
        code, said = REFUSED, str(error)
    except (Exception, SystemExit) as error:  # every fault of the file, of whatever kind
        code, said = FAILED, _reason(error, name)
    out.buffer.write(said.encode("utf-8", "replace"))
    out.flush()
    os._exit(code)  # at once: nothing is to be tidied up, and some of that would be refused


def _reason(error: BaseException, name: str) -> str:
    """Return what is wrong with a file of a name, and what to do."""
    cause = getattr(error, "exc", None) or error
    ours = isinstance(cause, PackageError | ArgumentError)
    kind, text = type(cause).__name__, " ".join(str(cause if ours else error).split())
    said = f"xacro cannot expand it: {'' if ours else f'{kind}: '}{text}"
    if isinstance(cause, ArgumentError) or "substitution argument" in text:
        said += "; [robot] xacro_arguments = { NAME = VALUE } of an arm.toml gives arguments"
    if isinstance(cause, PackageError):
        said += "; ROS_PACKAGE_PATH lists folders that hold packages, AMENT_PREFIX_PATH those with share/PACKAGE"
    if ours or "substitution argument" in text:
        said += f"; or expand it yourself: xacro {name} NAME:=VALUE > robot.urdf"
    return said


class _Arguments(dict[str, str]):
    """Values of arguments by name, and which the file has asked for."""

    def __init__(self, pairs: Iterable[Sequence[str]]) -> None:
        super().__init__((name, value) for name, value in pairs)
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


class PackageError(Exception):
    """There is no package of a name."""


class ArgumentError(Exception):
    """An argument has no value, or the file has no such argument."""


def _folders(variable: str) -> list[str]:
    return [folder for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


def find_package(folder: Path, package: str) -> str:
    """Return the folder of a ROS package: one above the file, or where ROS's own variables of the environment lead.

    Its name is what its package.xml says, or the name of its folder.
    """
    shares = [Path(prefix, "share", package) for prefix in _folders("AMENT_PREFIX_PATH")]
    roots = [Path(root) for root in _folders("ROS_PACKAGE_PATH")]
    above, listed = (folder, *folder.parents), (*shares, *(root / package for root in roots), *roots)
    said = (place for place in above if _named(place) == package)
    called = (place for place in listed if place.is_dir() and (_named(place) or place.name) == package)
    if place := next(chain(said, called), None):
        return str(place)
    for root in roots:
        for place, inside, _ in os.walk(root):
            if (name := _named(Path(place))) == package:
                return place
            if name or len(Path(place).relative_to(root).parts) >= DEEPEST:
                inside.clear()
    for place in above:
        if place.name == package:
            return str(place)
    raise PackageError(f"no package {package!r} above {folder} or where ROS_PACKAGE_PATH and AMENT_PREFIX_PATH lead")


def _named(folder: Path) -> str:
    """Return the name that a folder's package.xml says, '' where it has none."""
    try:
        with open(folder / "package.xml", encoding="utf-8", errors="replace") as file:
            name = re.search(r"<name>\s*([^<\s]+)\s*</name>", file.read(1 << 20))
    except OSError:
        return ""
    return name[1] if name else folder.name


def _file_of(find: Callable[[str], str], match: re.Match[str]) -> str:
    """Return where a mesh's package is, as it was written where there is none: meshes are only drawn."""
    try:
        return Path(find(match[1])).absolute().as_uri().replace("%20", " ")
    except PackageError:
        return match[0]


def confine(folder: Path, find_package: Callable[[str], str]) -> Callable[[str], str]:
    """Refuse from now on what no robot needs: files elsewhere than below a folder and named packages, and more.

    Return how packages are found.
    """
    xacro: Any = import_module("xacro")
    substitutions: Any = import_module("xacro.substitution_args")
    roots, looking = [os.path.realpath(folder)], list[str]()
    imports = [os.path.realpath(path) for path in sys.path if path]  # modules that are imported only now

    def find(package: str) -> str:
        if not re.fullmatch(r"[\w-]+", package):
            raise Refused(f"names a package {package!r}")
        looking.append(package)
        try:
            place = find_package(package)
        finally:
            looking.pop()
        roots.append(os.path.realpath(place))
        return place

    def refuse(what: str) -> Callable[..., Any]:
        def refused(*given: Any, **more: Any) -> None:
            raise Refused(what.format(*given))

        return refused

    substitutions._eval_find = find
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
            if writes or not any(Path(path).is_relative_to(root) for root in (*roots, *imports)):
                raise Refused(f"opens {os.fsdecode(given[0])}, which is not below its folder or a package it names")
        elif event.startswith(REACHING) and event not in ("os.listdir", "os.scandir"):
            raise Refused(f"asks the system for {event}")

    sys.addaudithook(watch)
    return find


if __name__ == "__main__":
    main()
