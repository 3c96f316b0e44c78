"""Given the wrong kind of thing every public function says so, and never fails somewhere inside."""

import inspect
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.small_arms import ROBOTS, one_joint, write

import armflex
from armflex.errors import ArmflexError, InputError

FOLDER = ROBOTS / "tarm_like"
ZOO: dict[str, object] = {
    "none": None,
    "true": True,
    "number": 3,
    "nan": np.nan,
    "text": "spam",
    "bytes": b"spam",
    "list": [1, 2],
    "texts": ["a", "b"],
    "dict": {"a": 1},
    "odd dict": {1: None},
    "set": {1},
    "array": np.zeros((2, 2)),
    "objects": np.array([None, "a"]),
    "object": object(),
    "class": int,
    "function": len,
    "complex": 1j,
    "fraction": Fraction(1, 2),
    "huge": 10**5000,
    "no path": "a\0b",
    "dates": np.array(["2020"], dtype="M8[D]"),
    "empty": [],
    "negative": -1,
    "generator": (i for i in range(3)),
    "namespace": SimpleNamespace(x=1),
}


def swing(folder: Path) -> armflex.Arm:
    """Return an arm of one joint: hundreds of effects are hidden in seven, each in a campaign of its own."""
    return one_joint(folder, 1e-8 * np.eye(6), (0.1, 0.0, 0.0))


FINE: dict[str, Callable[[armflex.Arm, Path], dict[str, object]]] = {
    "Arm": lambda arm, to: {"robot": arm.robot},
    "Flexure": lambda arm, to: {"name": "F", "joint": "A1", "law": arm.flexures[0].law},
    "Payload": lambda arm, to: {"mass": 1.0, "com": [0, 0, 0]},
    "Wrench": lambda arm, to: {"frame": "tool", "force": [0, 0, 1], "moment": [0, 0, 0]},
    "Trajectory": lambda arm, to: {
        "joint_names": arm.joint_names,
        "time": np.zeros(1),
        "q": arm.position()[None],
        "payload": ("none",),
        "via": ("",),
    },
    "Measurements": lambda arm, to: {
        **dict.fromkeys(("pose", "session", "payload"), ("none",)),
        **{"joint_names": arm.joint_names, "time": np.zeros(1), "q": arm.position()[None]},
        **{"approach": np.zeros((1, 7)), "measured": np.ones(1, dtype=bool)},
    },
    "Reading": lambda arm, to: {"q": arm.position(), "position": [1, 2, 3]},
    "Tracker": lambda arm, to: {"arm": arm},
    "as_in": lambda arm, to: {"arm": arm, "campaign": to / "few.csv"},
    "bundled_robot": lambda arm, to: {"name": "tarm_like"},
    "calibrate": lambda arm, to: {"arm": arm, "measurements": to / "few.csv"},
    "check": lambda arm, to: {"arm": arm, "trajectory": to / "path.csv", "tolerance": 0.1},
    "compensate": lambda arm, to: {"arm": arm, "trajectory": to / "path.csv"},
    "draw_laws": lambda arm, to: {"arm": arm, "path": to / "laws.png"},
    "ensemble": lambda arm, to: {"arm": arm, "q": arm.position(), "draws": 2},
    "iso9283": lambda arm, to: {"arm": arm, "measurements": to / "few.csv"},
    "load_arm": lambda arm, to: {"path": FOLDER / "arm.toml"},
    "load_law": lambda arm, to: {"path": to / "law.safetensors"},
    "make_arm": lambda arm, to: {"urdf": FOLDER / "tarm_like.urdf", "stiffness": {"A1": 1e6}},
    "map_workspace": lambda arm, to: {"arm": arm, "rows": 8},
    "plan": lambda arm, to: {"arm": arm, "rows": 1},
    "predict": lambda arm, to: {"arm": arm, "rows": to / "few.csv"},
    "read_joint_data": lambda arm, to: {"path": FOLDER / "a4_table_1.csv"},
    "read_measurements": lambda arm, to: {"path": to / "few.csv", "arm": arm},
    "read_trajectory": lambda arm, to: {"path": to / "path.csv", "arm": arm},
    "rehearse": lambda arm, to: {
        **{"arm": swing(to), "draws": 1},
        "rows": write(to, "q_j\n0\n1\n2\n-1\n-2\n", "swing.csv"),
    },
    "save_law": lambda arm, to: {"trained": None, "path": to / "law.safetensors"},
    "total_covariance": lambda arm, to: {"found": arm.deflection(arm.position())},
    "trace": lambda arm, to: {"arm": arm, "measurements": to / "few.csv"},
    "train": lambda arm, to: {"data": FOLDER / "a4_table_1.csv"},
    "view": lambda arm, to: {"arm": arm, "path": to / "arm.html"},
    "write_plan": lambda arm, to: {"found": None, "path": to / "plan.csv"},
    "write_trajectory": lambda arm, to: {"trajectory": None, "path": to / "path.csv"},
}
"""Arguments with which a function works, or would, as far as those that are not asked about go."""

CALLED = ("progress", "report", "account")
"""Functions of the caller's own, which may do with what they are given as they like."""

METHODS = ("payload", "position", "rigid_pose", "deflection", "prepared", "check_position", "loaded", "named")


@pytest.fixture(scope="module")
def arm() -> armflex.Arm:
    return armflex.load_arm(FOLDER / "measured.toml")


def accepts(call: Callable, name: str, known: dict[str, object], thing: object) -> str | None:
    """Return what went wrong where something other than a typed error was raised."""
    try:
        call(**{**known, name: thing})
    except ArmflexError:
        return None
    except Exception as error:
        return f"{name}={thing!r}: {type(error).__name__}: {error}"
    return None


def test_every_public_function_is_asked() -> None:
    shown = {name for name in armflex.__all__ if not name.startswith("_")}
    errors = {name for name in shown if isinstance(getattr(armflex, name), type) and "rro" in name}
    assert shown - errors - {"ArmflexWarning"} == set(FINE)


@pytest.mark.slow
@pytest.mark.parametrize("name", FINE)
@pytest.mark.filterwarnings("ignore::armflex.ArmflexWarning")
def test_wrong_kinds_of_things(name: str, arm: armflex.Arm, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for table, few, rows in (("campaign.csv", "few.csv", 5), ("trajectory.csv", "path.csv", 3)):
        (tmp_path / few).write_text("".join((FOLDER / table).read_text().splitlines(keepends=True)[: rows + 1]))
    call, known = getattr(armflex, name), FINE[name](arm, tmp_path)
    raw = []
    for one in inspect.signature(call).parameters.values():
        if one.kind is one.VAR_KEYWORD or one.name == "jobs":
            continue
        for thing in ZOO.values():
            if (one.default is None and thing is None) or (one.name in CALLED and callable(thing)):
                continue
            raw.append(accepts(call, one.name, known, thing))
    assert [said for said in raw if said] == []


@pytest.mark.parametrize("name", METHODS)
def test_wrong_kinds_of_things_for_an_arm(name: str, arm: armflex.Arm) -> None:
    call = getattr(arm, name)
    known = {"q": arm.position()} if "q" in inspect.signature(call).parameters else {}
    names = ["A1"] if name == "position" else inspect.signature(call).parameters
    raw = [accepts(call, one, known, thing) for one in names for thing in ZOO.values()]
    assert [said for said in raw if said] == []


@pytest.mark.filterwarnings("ignore:tolerance:armflex.ArmflexWarning")
def test_wrong_kinds_of_things_for_results(arm: armflex.Arm, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # a text is a file's name, too
    plain = armflex.load_arm(FOLDER / "arm.toml")
    path = armflex.read_trajectory(FOLDER / "trajectory.csv", plain)
    rows = armflex.read_measurements(FOLDER / "campaign.csv", arm)
    here, there = plain.deflection(plain.position()), plain.deflection(path.q)
    found = armflex.map_workspace(plain, rows=8)
    calls: list[tuple[Callable, dict[str, object]]] = [
        (found.margin, {}), (found.verdicts, {}), (armflex.view(plain).write, {}), (here.link_poses, {}),
        (here.shares, {}), (here.sigma, {}), (there.shares, {}), (there.sigma, {}), (path.for_arm, {}),
        (path.towards, {}), (path.with_constants, {"arm": plain, "constants": {}}),
        (armflex.Reading.of, {"measurements": rows, "row": 0}),
        (armflex.Tracker.restore, {"path": tmp_path / "state", "arm": plain}),
    ]  # fmt: skip
    raw = []
    for call, known in calls:
        for name in inspect.signature(call).parameters:
            raw += [(call.__qualname__, accepts(call, name, known, thing)) for thing in ZOO.values()]
    assert [said for said in raw if said[1]] == []


def test_the_argument_is_named(arm: armflex.Arm) -> None:
    path = FOLDER / "trajectory.csv"
    with pytest.raises(InputError, match=r"^check: arm is .*arm\.toml.*, expected an Arm$"):
        armflex.check(str(FOLDER / "arm.toml"), path, 0.1)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^check: tolerance is '100mm', expected a number or None$"):
        armflex.check(arm, path, "100mm")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^Arm\.position: A1 is 'x', expected a number$"):
        arm.position(A1="x")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"path is 3, expected the path of a table or a data frame$"):
        armflex.compensate(arm, 3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^payloads \(1,\): expected one name or several different ones"):
        armflex.map_workspace(arm, [1])  # type: ignore[list-item]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:gravity:armflex.ArmflexWarning")
def test_a_warning_points_at_the_line_that_asked(tmp_path: Path) -> None:
    row = "slew = { d = 0.4, lower = 0.5, upper = 1.0 }"
    (tmp_path / "arm.toml").write_text(f'[robot]\ndh = "standard"\n[robot.joint]\n{row}\n')
    with pytest.warns(armflex.ArmflexWarning, match="weightless") as told:
        found = armflex.load_arm(tmp_path / "arm.toml")
    with pytest.warns(armflex.ArmflexWarning, match="not_at_zero") as asked:
        found.position()
    assert {one.filename for one in (*told, *asked)} == {__file__}
