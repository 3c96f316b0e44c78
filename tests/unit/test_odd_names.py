"""Names are text: an arm and its campaign whose every name would be markup, a formula or a script to somebody."""

import csv
import json
import sys
import warnings
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np
import pytest
from click.testing import CliRunner, Result
from support.command_line import strict_json
from support.small_arms import joint, link, robot

from armflex import Reading, Tracker, load_arm, predict, read_measurements
from armflex.cli import terminal
from armflex.cli.main import Commands, main
from armflex.conventions import printable
from armflex.errors import ArmFileError, TableError, UrdfError
from armflex.measured.points import read_points
from armflex.plotting import picture
from armflex.show.view.law_curves import draw_laws
from armflex.show.view.meshcat_page import render_page
from armflex.show.view.scene_3d import Scene

MARKUP, FORMULA, SCRIPT, BOLD, DATA = "[/x]", r"$\frac{$", "<script>alert(1)</script>", "[bold", '"]</script>{{7*7}}'
ODD = (MARKUP, FORMULA, SCRIPT, BOLD, DATA)
JOINTS = (MARKUP, FORMULA, SCRIPT)
LINKS = (DATA, FORMULA, BOLD, SCRIPT, MARKUP)
PAYLOADS = {SCRIPT: 5.0, MARKUP: 40.0, FORMULA: 80.0}
POSES = 14
SIGMA = 5e-5
SESSIONS, COLUMN, REMARK = (MARKUP, SCRIPT), f"{FORMULA} temperature", BOLD
CODES = ("\x1b[31m", "\x9b2J", "\u202e", "\u2066", "\x07", "\u2028", "\x7f")
"""What would colour or clear a terminal, or turn the order of letters about."""


def quoted(text: str) -> str:
    return json.dumps(text)  # a TOML text, too


def urdf() -> str:
    """Return three joints, 1.7 m long, every name odd."""
    base, column, upper, fore, tool = (escape(name, {'"': "&quot;"}) for name in LINKS)
    yaw, pitch, bend = (escape(name, {'"': "&quot;"}) for name in JOINTS)
    return robot(
        link(base),
        joint(yaw, base, column, (0, 0, 0.4), axis=(0, 0, 1)),
        link(column, 40.0, (0.05, 0, 0.1)),
        joint(pitch, column, upper, (0.1, 0, 0.2)),
        link(upper, 30.0, (0.4, 0.02, 0)),
        joint(bend, upper, fore, (0.8, 0.05, 0)),
        link(fore, 20.0, (0.3, 0, 0.02)),
        joint("flange", fore, tool, (0.6, 0, 0), kind="fixed"),
        link(tool),
    )


def declared(effect: str = "") -> str:
    """Return arm.toml of that robot, with what a campaign may find."""
    lines = [
        "[robot]",
        'urdf = "arm.urdf"',
        f"tip = {quoted(LINKS[-1])}",
        f"base = {quoted(LINKS[0])}",
        "gravity = [0, 0, -9.81]",
    ]
    for name, mass in PAYLOADS.items():
        lines += [f"[payload.{quoted(name)}]", f"mass = {mass}", "com = [0.05, 0, 0]"]
    for name in JOINTS:
        lines += [f"[flexure.{quoted(name)}]", f"joint = {quoted(name)}", 'model = "linear"']
        lines += ["compliance = [1e-8, 1e-8, 1e-8, 2e-6, 2e-6, 2e-6]"]
    lines += ["[measurement]", 'frame = "base"', "[prior]", "joint_offset = 1e-3", "compliance = 0.2", effect]
    return "\n".join(lines) + "\n"


GROWN = f"""[[effect]]
name = "thermal_growth"
site = {quoted(SCRIPT)}
parameters = {{ alpha = 5e-5, reference = 0.0 }}
covariates = [{quoted(COLUMN)}]
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the arm, a trajectory, a campaign of an arm that is softer and grows with a column, and a joint's table."""
    folder = tmp_path_factory.mktemp("field")
    (folder / "arm.urdf").write_text(urdf())
    (folder / "arm.toml").write_text(declared())
    (folder / "true.toml").write_text(declared(effect=GROWN))
    rng = np.random.default_rng(3)
    rows = rng.uniform(-1.2, 1.2, (POSES, 3)).repeat(3, axis=0)
    table = {
        "pose": [f"{ODD[i % 5]} {i}" for i in range(POSES) for _ in PAYLOADS],
        "session": [SESSIONS[i % 2] for i in range(len(rows))],
        "payload": list(PAYLOADS) * POSES,
        **{f"q_{name}": rows[:, i].tolist() for i, name in enumerate(JOINTS)},
        COLUMN: rng.uniform(-10.0, 10.0, len(rows)).tolist(),
        REMARK: [ODD[i % 2] for i in rng.integers(0, 2, len(rows))],
    }
    write_csv(folder / "rows.csv", table)
    true = load_arm(folder / "true.toml")
    position = predict(true, read_measurements(folder / "rows.csv", true, inputs_only=True)).position
    position += rng.normal(0.0, SIGMA, position.shape)
    measured = {axis: position[:, i].tolist() for i, axis in enumerate("xyz")}
    write_csv(folder / "campaign.csv", {**table, **measured, "sigma": [SIGMA] * len(rows)})
    path = {f"q_{name}": [0.1 * i, 0.3, -0.2 * i] for i, name in enumerate(JOINTS)}
    write_csv(
        folder / "path.csv",
        {"time": [0.0, 1.0, 2.0], **path, "payload": list(PAYLOADS), "via": [MARKUP, FORMULA, SCRIPT]},
    )
    loads = rng.normal(size=(30, 6)) * [1e3, 1e3, 1e3, 500.0, 500.0, 500.0]
    names = ("fx", "fy", "fz", "mx", "my", "mz", "dx", "dy", "dz", "rx", "ry", "rz")
    units = ("N",) * 3 + ("Nm",) * 3 + ("mm",) * 3 + ("mrad",) * 3
    both = np.hstack([loads, loads * [1e-5, 1e-5, 1e-5, 2e-3, 2e-3, 2e-3] + rng.normal(0.0, 1e-4, loads.shape)])
    write_csv(
        folder / "joint.csv",
        {f"{name}_{unit}": both[:, i].tolist() for i, (name, unit) in enumerate(zip(names, units, strict=True))},
    )
    return folder


def write_csv(path: Path, columns: dict[str, list]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def run(name: str, *arguments: object) -> Result:
    """Run a command in this process, which is quicker than in one of its own."""
    terminal._said.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return CliRunner().invoke(Commands().get_command(None, name), list(map(str, arguments)))


def done(name: str, *arguments: object) -> str:
    """Return what a command says on both streams; fail with its traceback."""
    result = run(name, *arguments)
    if result.exception:
        raise result.exception
    return result.output


class Page(HTMLParser):
    """What a browser makes of a page: its elements by name, its text, and what its scripts hold."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[str] = []
        self.text, self.script = "", ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list) -> None:
        self.elements.append(tag)
        assert not any(name.startswith("on") for name, _ in attributes)

    def handle_data(self, data: str) -> None:
        if self.cdata_elem == "script":
            self.script += data
        else:
            self.text += data


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Return a page on which there is nothing."""
    path = tmp_path_factory.mktemp("plain") / "page.html"
    path.write_text(render_page(Scene("plain")), encoding="utf-8")
    return Page(path)


def shown(page: Page, plain: Page, *names: str) -> None:
    """Hold a page against one without names: no element more but of its table, and every name is there as text."""
    assert page.elements.count("script") == plain.elements.count("script")
    assert set(page.elements) - set(plain.elements) <= {"table", "tr", "td", "h2", "li", "i"}
    assert all(name in page.text or json.dumps(name).replace("<", "\\u003c") in page.script for name in names)


def is_png(path: Path) -> bool:
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000


def test_deflect(field: Path) -> None:
    q = f"{FORMULA}=0.3,{SCRIPT}=10deg"
    said = done("deflect", field / "arm.toml", "--q", q, "--payload", MARKUP, "--force", f"{MARKUP}=0,0,-10N")
    assert all(name in said for name in (*JOINTS, LINKS[0], MARKUP))


def test_check_compensate_and_predict(field: Path, tmp_path: Path) -> None:
    result = run("check", field / "arm.toml", field / "path.csv", "--tolerance", "4mm", "--json", tmp_path / "c.json")
    assert all(name in result.stdout for name in (*PAYLOADS, *JOINTS, LINKS[0]))
    points = strict_json(tmp_path / "c.json")["via_points"]
    assert {point["name"] for point in points} == {MARKUP, FORMULA, SCRIPT}
    said = done("compensate", field / "arm.toml", field / "path.csv", "-o", tmp_path / "c.csv")
    assert all(name in said for name in PAYLOADS) and FORMULA in (tmp_path / "c.csv").read_text()
    said = done("predict", field / "arm.toml", field / "rows.csv", "-o", tmp_path / "p.csv")
    assert f"(tip {LINKS[-1]}, base frame {LINKS[0]})" in " ".join(said.split())


def test_calibrate_and_what_it_wrote(field: Path, tmp_path: Path) -> None:
    folder = tmp_path / "[bold] $x$ <b>"
    folder.mkdir()
    said = done("calibrate", field / "arm.toml", field / "campaign.csv", "-o", folder / "fitted.toml", "--all")
    assert all(f"joint_offset {name}" in said for name in JOINTS)
    assert f"Written to {folder}".replace("/", "") in said.replace("\n", "").replace("/", "")
    fitted = load_arm(folder / "fitted.toml")
    assert set(fitted.corrections.joint_offset) == set(JOINTS)


@pytest.mark.slow
def test_learned_laws_and_their_picture(field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "240")
    (tmp_path / "arm.urdf").write_text((field / "arm.urdf").read_text())
    (tmp_path / "arm.toml").write_text(declared().replace('model = "linear"', 'model = "linear"\nlearn = true', 2))
    said = done("calibrate", tmp_path / "arm.toml", field / "campaign.csv", "-o", tmp_path / "learned.toml")
    assert "Laws learned" in said and all(f"law {name} ry" in said for name in (MARKUP, FORMULA))
    assert is_png(draw_laws(load_arm(tmp_path / "learned.toml"), tmp_path / "laws.png"))


@pytest.mark.slow
def test_trace_and_its_report(field: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "traced.toml", tmp_path / "trace.html"
    said = done("trace", field / "arm.toml", field / "campaign.csv", "-o", out, "--report", page)
    assert "thermal_growth" in said and SCRIPT in said and "calibrating" in said
    assert {effect.location.covariates for effect in load_arm(out).effects} == {(COLUMN,)}
    found = Page(page)
    assert "script" not in found.elements and all(name in found.text for name in (*JOINTS, COLUMN))


@pytest.mark.slow
def test_plan_and_its_picture(field: Path, tmp_path: Path) -> None:
    out, drawn = tmp_path / "plan.csv", tmp_path / "plan.png"
    given = ["--rows", "3", "--after", field / "campaign.csv", "--along", field / "path.csv"]
    said = done("plan", field / "arm.toml", "-o", out, "--picture", drawn, *given)
    assert any(name in said for name in JOINTS) and is_png(drawn)
    assert set(PAYLOADS) >= {row["payload"] for row in csv.DictReader(out.open(newline=""))}


def test_map_its_page_and_its_picture(field: Path, tmp_path: Path, plain: Page) -> None:
    files = ["-o", tmp_path / "m.safetensors", "--page", tmp_path / "m.html", "--picture", tmp_path / "m.png"]
    carried = f"{MARKUP},{FORMULA}"
    said = done("map", field / "arm.toml", *files, "--rows", "64", "--payload", carried, "--no-uncertainty")
    assert all(name in said for name in (*JOINTS, MARKUP, FORMULA, LINKS[0])) and is_png(tmp_path / "m.png")
    shown(Page(tmp_path / "m.html"), plain, LINKS[0], MARKUP, FORMULA)


def test_view(field: Path, tmp_path: Path, plain: Page) -> None:
    given = ["--traj", field / "path.csv", "--tolerance", "4mm", "-o", tmp_path / "v.html"]
    done("view", field / "arm.toml", *given)
    shown(Page(tmp_path / "v.html"), plain, *JOINTS)


def test_train_from_and_to_files_of_odd_names(field: Path, tmp_path: Path) -> None:
    table = tmp_path / f"{MARKUP.replace('/', '')}{FORMULA} <b>.csv"
    table.write_bytes((field / "joint.csv").read_bytes())
    said = done("train", table, "-o", tmp_path / "[red] :smile:.safetensors")
    assert "[red] :smile:.safetensors" in said.replace("\n", "")
    table.write_text((field / "joint.csv").read_text().replace("dz_mm", FORMULA))
    with pytest.raises(TableError, match="has no column 'dz'") as caught:
        done("train", table, "-o", tmp_path / "o.safetensors")
    assert FORMULA in str(caught.value)


def test_tracker_names_what_changed(field: Path) -> None:
    arm = load_arm(field / "arm.toml")
    rows = read_measurements(field / "campaign.csv", arm)
    place, tracker, change = predict(arm, rows).position, Tracker(arm), None
    turned = np.array([[0.0, -1e-2, 0.0], [1e-2, 0.0, 0.0], [0.0, 0.0, 0.0]])  # the first joint stands elsewhere
    for i in range(24):
        moved = turned @ place[i] * (i >= 12)
        found = tracker.update(Reading(rows.q[i], place[i] + moved, SIGMA, rows.payload[i]))
        change = change or found.change
    assert change is not None and change.name == f"joint_offset {MARKUP}"


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_every_text_of_a_picture_is_drawn_as_it_is(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"p{suffix}"
    with picture(path, 4.0, 3.0) as figure:
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1e-7], label=FORMULA)
        axes.set(title=FORMULA, xlabel="$x$", ylabel=SCRIPT)
        axes.set_xticks([0.0, 1.0], [FORMULA, "$$"])
        axes.legend(title=FORMULA)
        figure.suptitle(FORMULA)
    assert path.stat().st_size > 2_000 and (suffix != ".svg" or ElementTree.parse(path))


@pytest.mark.parametrize("code", CODES)
def test_what_cannot_be_shown_is_refused_with_its_place(field: Path, tmp_path: Path, code: str) -> None:
    escaped = "holds the character " + printable(code)[:2].replace("\\", r"\\")
    (tmp_path / "arm.urdf").write_text((field / "arm.urdf").read_text())
    arm = tmp_path / "arm.toml"
    arm.write_text(declared().replace(f"[payload.{quoted(MARKUP)}]", f"[payload.{quoted('p' + code)}]"))
    line = arm.read_text().split("[payload.")[0].count("\n") + 3 + 1
    with pytest.raises(ArmFileError, match=rf"arm\.toml:{line}: .* {escaped}"):
        load_arm(arm)
    for name in ("path.csv", "campaign.csv"):
        table = tmp_path / name
        table.write_text((field / name).read_text().replace(f",{MARKUP},", f",{MARKUP}{code},", 1))
        command = ["check", field / "arm.toml", table, "--tolerance", "1mm"]
        command = command if name == "path.csv" else ["calibrate", field / "arm.toml", table, "-o", tmp_path / "o.toml"]
        with pytest.raises(TableError, match=rf"{name}:\d+: {escaped}"):
            done(*command)
    (tmp_path / "points.txt").write_text(f"// Units: mm\nA p1{code} 1 2 3\n")
    with pytest.raises(TableError, match=rf"points\.txt:2: {escaped}"):
        read_points(tmp_path / "points.txt", frame="World")
    if code >= "\x7f":  # XML has no other way to hold the rest
        (tmp_path / "arm.urdf").write_text(urdf().replace('"flange"', f'"fl&#{ord(code[0])};ange"'))
        with pytest.raises(UrdfError, match=rf"arm\.urdf:\d+: <joint name=.* {escaped}"):
            load_arm(tmp_path / "arm.urdf")


def test_a_remark_may_have_line_breaks_and_tabs(field: Path, tmp_path: Path) -> None:
    arm, table = load_arm(field / "arm.toml"), tmp_path / "rows.csv"
    rows = list(csv.DictReader((field / "rows.csv").open(newline="")))
    write_csv(table, {name: [row[name] for row in rows] for name in rows[0]} | {"remark": ["a\tb\nc"] * len(rows)})
    assert set(read_measurements(table, arm, inputs_only=True).covariates["remark"]) == {"a\tb\nc"}


@pytest.mark.parametrize("code", ["\x1b[31m", "\u202e", "\n", "\udcff"])
def test_nothing_from_outside_moves_the_cursor(
    field: Path, tmp_path: Path, code: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Errors, warnings and what is said of files; `\\udcff` stands for a byte that is no UTF-8."""
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # which the command line replaces
    odd, told = f"a{code}b", printable(f"a{code}b")

    def said(status: int, *arguments: object) -> tuple[str, str]:
        terminal._said.clear()
        monkeypatch.setattr(sys, "argv", ["armflex", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        assert ended.value.code == status and (code == "\n" or code not in out + err)
        return out, err

    for arguments in (
        ["deflect", odd],
        ["deflect", field / "arm.toml", "--payload", odd],
        ["deflect", field / "arm.toml", "--force", f"{odd}=0,0,-1N"],
        ["deflect", field / "arm.toml", "--json", f"none/{odd}"],
    ):
        _, err = said(2, *arguments)
        assert err.count("\n") == 1 and (told in err or repr(odd)[1:-1] in err)
    page = tmp_path / f"{odd}.html"
    out, _ = said(0, "view", field / "arm.toml", "-o", page)
    assert f"{told}.html" in out.replace("\n", "") and page.exists()
    (tmp_path / f"{odd}.urdf").write_text(urdf())
    _, err = said(0, "view", tmp_path / f"{odd}.urdf", "--tip", MARKUP, "-o", page)
    assert "warning: rigid" in err and page.stat().st_size > 500_000


@pytest.mark.slow
def test_every_doubt_and_step_is_escaped(capsys: pytest.CaptureFixture) -> None:
    from armflex.cli.terminal import complain, heading, print_table, say

    for show in (complain, say, heading, lambda text: print_table(text, [text], [[text], [text]])):
        show(f"{MARKUP}{FORMULA} :smile: \x1b[31m\u202e\n")
        said = capsys.readouterr()
        assert "\x1b" not in said.out + said.err and "\u202e" not in said.out + said.err
        assert f"{MARKUP}{FORMULA} :smile: \\x1b[31m\\u202e\\n" in said.out + said.err
