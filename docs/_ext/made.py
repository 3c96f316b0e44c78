"""What is made before the pages are read: everything that the code says better than a page that somebody keeps.

It goes to `_made`, which pages include. What takes seconds is kept until a file that it depends on changes.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import re
from pathlib import Path

import click
import effects
import formats
import pictures
from pygments.lexers.shell import BashLexer
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.ext import napoleon
from sphinx.ext.napoleon import GoogleDocstring

import armflex
from armflex import readings
from armflex.cli.main import COMMANDS

DOCS = Path(__file__).parents[1]
ROOT, MADE = DOCS.parent, DOCS / "_made"
PACKAGE = ROOT / "armflex"

GROUPS = {
    "An arm and its deflection": ("arm", "bundled", "robot", "files", "mechanics", "estimate.tip_uncertainty"),
    "Paths": ("trajectory", "tasks.check", "tasks.compensate", "tasks.predict", "export"),
    "Campaigns, calibration, tracing": ("measured", "rows", "estimate", "trace", "readings", "tasks.iso9283"),
    "What to measure next, and tracking": ("plan", "track"),
    "Joint laws from a bench": ("bench", "laws"),
    "Maps and pages": ("tasks.workspace", "show"),
    "Errors": ("errors",),
}
"""Heading -> packages whose names stand under it."""

FURTHER = (
    *("mechanics.deflection.Deflection", "mechanics.deflection.DeflectionBatch", "robot.load_robot"),
    *("tasks.check.CheckReport", "tasks.compensate.Compensation", "tasks.predict.Prediction"),
    *(
        "estimate.Calibration",
        "estimate.bootstrap.bootstrap",
        "estimate.bootstrap.Bootstrap",
        "estimate.draw.draw_arms",
    ),
    *("trace.findings.Trace", "tasks.iso9283.PosePerformance", "measured.points.read_points"),
    *("measured.repeats.repeats", "measured.repeats.Repeats", "rows.rows.pose_groups", "rows.rows.leaked"),
    *("plan.planned_rows.Plan", "plan.picture.draw_plan", "track.watch.Change"),
    *("measured.joint_data.JointData", "bench.training.TrainResult"),
    *("tasks.workspace.WorkspaceMap", "tasks.workspace.draw_map", "tasks.workspace.read_map"),
    *("tasks.workspace.write_map", "show.view.map_page.map_page"),
)
"""What the names of `armflex` return, and what is needed more rarely: imported from its module."""

HEADS = {
    "Equilibrium": (
        "mechanics",
        "mechanics.equilibrium",
        "mechanics.certificate",
        "mechanics.engine",
        "mechanics.many_rows",
    ),
    "How the tip responds": ("mechanics.response",),
    "Joint laws": ("laws.joint.structural", "laws.joint.log_compliance", "laws.joint.hardening", "laws.joint.network"),
    "Calibration": ("linear_gaussian", "estimate.fit", "estimate.identify", "estimate.misread", "estimate.learn"),
    "Tracing": (
        "trace.projection",
        "trace.hypotheses",
        "trace.selection",
        "trace.refine",
        "trace.search",
        "trace.probabilities",
        "trace.unrecorded",
        "trace.validate",
    ),
    "What to measure next": ("plan.design",),
    "Tracking": ("track.watch",),
    "Joint laws from a bench": (
        "bench.fit_linear",
        "bench.network_problem",
        "bench.fit_bayesian",
        "sampling.metropolis",
    ),
}
"""Heading -> modules whose heads derive what they do."""


def commands() -> str:
    """Return every command as its `--help` has it, from the same declarations."""
    lines: list[str] = []
    for name, brief in COMMANDS.items():
        command = importlib.import_module(f"armflex.cli.{name}_command").command
        context = click.Context(command, info_name=f"armflex {name}")
        usage = command.get_usage(context).removeprefix("Usage: ")
        lines += [f"(armflex-{name})=", f"## `armflex {name}`", "", f"{brief[:1].upper()}{brief[1:]}.", ""]
        lines += ["```text", " ".join(usage.split()), "```", "", _prose(inspect.cleandoc(command.help or "")), ""]
        rows = []
        for one in command.params:
            if isinstance(one, click.Option) and not one.hidden:
                flags = ", ".join(f"`{flag}`" for flag in one.opts)
                kind = "" if one.is_flag else f" *{_metavar(one, context)}*"
                default = one.get_default(context)
                shown = f" (default: `{default}`)" if one.show_default or default not in (None, False, (), "") else ""
                shown = "" if callable(default) or "Sentinel" in str(default) else shown
                rows.append(
                    f"| {flags}{kind} | {_cell(one.help or '')}{shown}{' **Required.**' if one.required else ''} |"
                )
        lines += ["| option | |", "|---|---|", *rows, ""] if rows else []
    return "\n".join(lines)


def _metavar(one: click.Option, context: click.Context) -> str:
    if isinstance(one.type, click.Choice):
        return ", ".join(map(str, one.type.choices))
    return one.metavar or one.type.name.upper()


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _prose(text: str) -> str:
    """Return a docstring as Markdown: what is indented is a formula, a list or an example, as it stands."""
    parts, text = [], re.sub(r"\\b\n", "", text)
    for block in re.split(r"\n\s*\n", text.strip("\n")):
        lines = block.split("\n")
        if all(line.startswith("    ") for line in lines):
            parts.append("```text\n" + "\n".join(line[4:] for line in lines) + "\n```")
            continue
        cut = next((i for i, line in enumerate(lines) if i and line.startswith("    ")), len(lines))
        parts.append("\n".join(re.sub(r"(?<!`)<(?=\w)", "&lt;", line) for line in lines[:cut]))
        if cut < len(lines):
            parts.append("```text\n" + "\n".join(line.removeprefix("    ") for line in lines[cut:]) + "\n```")
    return "\n\n".join(parts)


def heads() -> str:
    """Return the heads of modules that derive what they do."""
    lines: list[str] = []
    for title, modules in HEADS.items():
        lines += [f"## {title}", ""]
        for module in modules:
            path = PACKAGE / f"{module.replace('.', '/')}.py"
            path = path if path.exists() else path.with_suffix("") / "__init__.py"
            if not path.exists():
                raise FileNotFoundError(f"docs/_ext/made.py: HEADS names armflex.{module}, which is not there")
            text = ast.get_docstring(ast.parse(path.read_text())) or ""
            first, _, rest = text.partition("\n\n")
            title_of = " ".join(first.split()).rstrip(".")
            shown = title_of.replace("[", "\\[")
            lines += [f"### {shown}", "", f"`armflex/{path.relative_to(PACKAGE).as_posix()}`", "", _prose(rest), ""]
    return "\n".join(lines)


def api() -> str:
    """Return every public name of the package under a heading, and what they return behind them."""
    lines: list[str] = []
    found: dict[str, list[str]] = {title: [] for title in GROUPS}
    own = [f"{module}.{name}".removeprefix("armflex.") for name, module in armflex.EXPORTS.items()]
    for place in (*own, *FURTHER):
        fitting = [
            (len(prefix), title) for title, some in GROUPS.items() for prefix in some if place.startswith(prefix + ".")
        ]
        short = place.rpartition(".")[2] if place in own else place
        found[max(fitting)[1] if fitting else "An arm and its deflection"].append(short)
    for title, names in found.items():
        lines += [f"## {title}", "", "```{eval-rst}"]
        for name in names:
            module, _, last = f"armflex.{name}".rpartition(".")
            if isinstance(getattr(importlib.import_module(module), last), type):
                lines += [
                    f".. autoclass:: armflex.{name}",
                    "   :members:",
                    "   :inherited-members: Exception, object",
                    "",
                ]
            else:
                lines += [f".. autofunction:: armflex.{name}", ""]
        lines += ["```", ""]
    return "\n".join(lines)


def conventions() -> str:
    """Return the head of `armflex.conventions`, and the units that are understood."""
    module = importlib.import_module("armflex.conventions")
    lines = [_prose((module.__doc__ or "").partition("\n\n")[2]), "", "| quantity | units |", "|---|---|"]
    lines += [f"| {kind} | {', '.join(f'`{unit}`' for unit in units)} |" for kind, units in module.UNITS.items()]
    return "\n".join(lines) + "\n"


def instruments() -> str:
    """Return every kind of instrument: what it reads, its columns, its unit, and what of it can be found."""
    lines = [
        "| `kind` | reads | columns of `[instrument.NAME]` | unit | what can be found with it |",
        "|---|---|---|---|---|",
    ]
    for name, kind in readings.SENSOR_KINDS.items():
        said = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
        columns = ", ".join(f"`{column}`" for column in kind.columns("NAME"))
        own = ", ".join(f"`{one.name}` [{one.unit}]" for one in kind.nuisances)
        lines.append(f"| `{name}` | {_cell(said)} | {columns} | {kind.unit} | {own} |")
    return "\n".join(lines) + "\n"


def bench() -> str:
    """Return what `make bench` wrote, under this page's headings."""
    file = DOCS / "results" / "bench.md"
    text = file.read_text() if file.exists() else "`make bench` has not been run.\n"
    return re.sub(r"^# .*\n", "", text).replace("\n## ", "\n### ")


def study() -> str:
    """Return what `make study` wrote, and runs of it that were kept."""
    lines = [file.read_text() for file in sorted((DOCS / "results").glob("study*.md"))]
    return "\n".join(lines) or "`make study` has not been run.\n"


def examples() -> str:
    """Return a table of the examples."""
    rows = []
    for file in sorted((ROOT / "examples").glob("*.py")):
        text = " ".join((ast.get_docstring(ast.parse(file.read_text())) or "").split("\n\n")[0].split())
        rows.append(f"| `examples/{file.name}` | {_cell(text)} |")
    return "\n".join(["| | |", "|---|---|", *rows]) + "\n"


def _write(name: str, text: str) -> None:
    file = MADE / name
    if not file.exists() or file.read_text() != text:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def _is_new(name: str, digest: str) -> bool:
    """Return whether something was made from other sources, or not yet; remember that it is made now."""
    mark = MADE / f"{name}.sha256"
    before = mark.read_text() if mark.exists() else ""
    mark.write_text(digest)
    return before != digest


def make(app: Sphinx | None = None) -> None:
    """Write everything."""
    MADE.mkdir(exist_ok=True)
    read = formats.columns()
    _write("arm.md", formats.arm_page())
    for file in read:
        _write(f"{file}.md", formats.table_page(file, read))
    for name, page in {
        "commands": commands,
        "heads": heads,
        "api": api,
        "conventions": conventions,
        "instruments": instruments,
        "bench": bench,
        "study": study,
        "examples": examples,
    }.items():
        _write(f"{name}.md", page())
    code = [*PACKAGE.rglob("*.py"), *(DOCS / "_ext").glob("*.py")]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(code))).hexdigest()
    if _is_new("effects", digest):
        _write("effects.md", effects.page(*effects.shown(), MADE / "effects"))
    if _is_new("pictures", digest):
        pictures.draw(MADE / "pictures")
    if _is_new("notebooks", digest):  # they are run again
        for mark in (MADE / "notebooks").glob("*.md5"):
            mark.unlink()


def fetches_nothing(app: Sphinx, failure: Exception | None) -> None:
    """Raise where a page would fetch a script, a style, a font or a picture from elsewhere."""
    wanted = re.compile(
        r'<(?:script|img|link[^>]*rel="(?:stylesheet|preload|icon)")[^>]*(?:src|href)="(?:https?:)?//[^"]*"'
    )
    style = re.compile(r"(?:@import|url\()\s*[\"']?(?:https?:)?//")
    for pattern, files in ((wanted, "*.html"), (style, "*.css")):
        for file in sorted(Path(app.outdir).rglob(files)) if not failure else ():
            if found := pattern.search(file.read_text(encoding="utf-8")):
                raise ExtensionError(f"{file.name} fetches {found[0]}")


class _Docstring(GoogleDocstring):
    """A docstring in which what a property's first line says before a colon is no type."""

    def __init__(self, docstring, config=None, app=None, what="", *rest) -> None:
        super().__init__(docstring, config, app, "method" if what == "property" else what, *rest)


def _signature(app: Sphinx, what: str, name: str, thing: object, options: object, *said: str | None) -> tuple | None:
    """Return no signature of a class, whose attributes are listed, and an alias by its name in all others."""
    if said[0] is None:
        return None
    named = tuple(text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in said)
    return ("", "") if what == "class" else named


def _aliases(app: Sphinx, page: str, template: str, context: dict, doctree: object) -> None:
    """Call an alias by its name in overloads, too."""
    if page == "api":
        tag, end = r"(?:</?span[^>]*>|[('])*", r"<span class=\"pre\">\)</span></span>"
        pattern = rf"TypeAliasForwardRef{tag}(\w+){tag}{end}"
        context["body"] = re.sub(pattern, r"\1</span>", context["body"])


def setup(app: Sphinx) -> dict[str, bool]:
    """Make everything before Sphinx looks for pages."""
    napoleon.GoogleDocstring = _Docstring
    app.add_lexer("console", BashLexer)  # that of Pygments takes a command without a prompt for output
    app.connect("autodoc-process-signature", _signature)
    app.connect("html-page-context", _aliases)
    app.connect("build-finished", fetches_nothing)
    app.connect("config-inited", lambda app, config: make(app), priority=100)
    return {"parallel_read_safe": True}
