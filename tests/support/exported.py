"""Exported files as their readers have them: small independent parsers and kinematics, sharing no code with armflex."""

import csv
import io
import re
from xml.etree import ElementTree

import numpy as np

Array = np.ndarray


def rotation(axis: str, angle: float) -> Array:
    """Return a (4, 4) rotation about x, y or z."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    T = np.eye(4)
    T[j, j] = T[k, k] = np.cos(angle)
    T[k, j], T[j, k] = np.sin(angle), -np.sin(angle)
    return T


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def placed(row: dict[str, float]) -> Array:
    """Return the pose of x y z roll pitch yaw, as URDF has them."""
    turned = rotation("z", row["yaw"]) @ rotation("y", row["pitch"]) @ rotation("x", row["roll"])
    return shift(row["x"], row["y"], row["z"]) @ turned


class Sheet:
    """A sheet's CSV as a controller would be given it.

    Attributes:
        value, std: By section, joint and quantity, SI; std is None where the cell is empty.
    """

    def __init__(self, text: str) -> None:
        rows = list(csv.DictReader(io.StringIO(text)))
        key = [(row["section"], row["of"], row["quantity"]) for row in rows]
        assert len(set(key)) == len(key)
        self.value = {k: float(row["value"]) for k, row in zip(key, rows, strict=True)}
        self.std = {k: float(row["std"]) if row["std"] else None for k, row in zip(key, rows, strict=True)}
        self.unit = {k: row["unit"] for k, row in zip(key, rows, strict=True)}
        self.joints = [of for section, of, quantity in key if (section, quantity) == ("dh_standard", "theta")]
        for row in rows:
            if row["unit"] == "rad":
                assert np.isclose(np.radians(float(row["value_deg"])), float(row["value"]), rtol=1e-14, atol=0.0)

    def tip(self, q: Array, section: str, beta: bool = True) -> Array:
        """Return the (4, 4) pose of the tip where the controller reads q and adds the offsets."""
        T = placed({name: self.value["base", "", name] for name in ("x", "y", "z", "roll", "pitch", "yaw")})
        for joint, reading in zip(self.joints, q, strict=True):
            true = reading + self.value.get(("joint_offset", joint, "offset"), 0.0)  # a joint without a drive has none
            slides = self.unit.get(("joint_offset", joint, "offset")) == "m"
            theta, d, a, alpha, tilt = (
                self.value[section, joint, name] for name in ("theta", "d", "a", "alpha", "beta")
            )
            theta, d = (theta, d + true) if slides else (theta + true, d)
            own = rotation("z", theta) @ shift(z=d)
            across = shift(x=a) @ rotation("x", alpha) @ rotation("y", tilt if beta else 0.0)
            T = T @ (own @ across if section == "dh_standard" else across @ own)
        return T @ placed({name: self.value["tool", "", name] for name in ("x", "y", "z", "roll", "pitch", "yaw")})


def ur_poses(text: str) -> tuple[Array, list[Array], Array]:
    """Return what comes before, the six joints' poses and what comes after, of a calibration for ur_description."""
    ends = {}
    for name, flow in re.findall(r"^# ([\w ]+): \{(.*)\}$", text, re.M):
        ends[name] = placed({key: float(value) for key, value in (one.split(": ") for one in flow.split(", "))})
    links: dict[str, dict[str, float]] = {}
    for line in text.split("kinematics:\n")[1].splitlines():
        if match := re.fullmatch(r"  (\w+):", line):
            links[match[1]] = row = {}
        elif match := re.fullmatch(r"    (\w+): (\S+)", line):
            row[match[1]] = float(match[2])
    assert list(links) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]
    return ends["base to the parent of shoulder"], [placed(row) for row in links.values()], ends["wrist_3 to tip"]


def offsets_of(text: str) -> dict[str, float]:
    """Return robot_calibration's offsets as its own reader finds them: word, number, and the word loses its colon."""
    found = {}
    for line in text.splitlines():
        word, value = line.split()
        found[word[:-1]] = float(value)
    return found


NUMBER = r"-?\d+(?:\.\d+)?(?:E\d+)?"


def urscript_moves(text: str) -> list[tuple[list[float], float | None, float | None]]:
    """Return joints [rad], time [s] and blend [m] of every movej of a program that is nothing else."""
    lines = [line.split("#")[0].rstrip() for line in text.splitlines()]
    assert re.fullmatch(r"def \w+\(\):", lines[0]) and lines[-1] == "end"
    moves = []
    for line in filter(None, lines[1:-1]):
        match = re.fullmatch(rf"  movej\(\[((?:{NUMBER}(?:, )?)+)\](?:, t=({NUMBER}))?(?:, r=({NUMBER}))?\)", line)
        assert match, line
        moves.append(([float(x) for x in match[1].split(",")], *(float(x) if x else None for x in match.groups()[1:])))
    return moves


def krl_moves(text: str) -> list[dict[str, float]]:
    """Return axes by name [deg, mm] of every PTP of a program that is nothing else."""
    lines = [line.split(";")[0].rstrip() for line in text.splitlines()]
    assert re.fullmatch(r"DEF \w+\(\)", lines[0]) and lines[-1] == "END"
    (first, *rest) = filter(None, lines[1:-1])
    assert first == "BAS(#INITMOV,0)"
    moves = []
    for line in rest:
        match = re.fullmatch(r"PTP \{E6AXIS: (.*)\}", line)
        assert match, line
        moves.append({axis: float(x) for axis, x in (one.split(" ") for one in match[1].split(", "))})
        assert all(re.fullmatch("[AE][1-6]", axis) for axis in moves[-1])
    return moves


def rapid_moves(text: str) -> list[tuple[list[float], list[float], float | None, list[float] | None]]:
    """Return robot axes [deg], external axes [mm], time [s] and zone of every MoveAbsJ of a module of one procedure."""
    lines = [line.split("!")[0].strip() for line in text.splitlines()]
    assert re.fullmatch(r"MODULE \w+", lines[0]) and lines[-2:] == ["ENDPROC", "ENDMODULE"]
    (head, *rest) = filter(None, lines[1:-2])
    assert re.fullmatch(r"PROC \w+\(\)", head)
    listed, moves = rf"\[({NUMBER}(?:,{NUMBER}){{5}})\]", []
    for line in rest:
        zone = rf"fine|\[FALSE((?:,{NUMBER}){{6}})\]"
        match = re.fullmatch(
            rf"MoveAbsJ \[{listed},{listed}\]\\NoEOffs,v100(?:\\T:=({NUMBER}))?,(?:{zone}),tool0;", line
        )
        assert match, line
        robot, external, time, radii = match.groups()
        moves.append(
            (
                [float(x) for x in robot.split(",")],
                [float(x) for x in external.split(",")],
                float(time) if time else None,
                [float(x) for x in radii[1:].split(",")] if radii else None,
            )
        )
    return moves


def ls_moves(text: str) -> list[tuple[dict[str, float], float | None]]:
    """Return axes by name [deg, mm] and time [s] of every J move of a TP program, None at a share of speed."""
    head, rest = text.split("\n/MN\n")
    assert re.match(r"/PROG  [A-Z]\w*\n/ATTR\n", head) and text.endswith("/END\n")
    body, held = rest.removesuffix("/END\n").split("/POS\n")
    places = {}
    for number, axes in re.findall(r"P\[(\d+)\]\{\n   GP1:\n\tUF : 0, UT : 1,\n([^}]*)\n\};\n", held):
        pairs = re.findall(rf"(J[1-6]|E[1-3])= ({NUMBER}) (deg|mm)", axes)
        assert axes.count("=") == len(pairs)
        places[int(number)] = {axis: float(x) for axis, x, _ in pairs}
        assert all((axis[0] == "J") <= (unit == "deg") for axis, _, unit in pairs)
    moves = []
    for count, line in enumerate(body.splitlines(), 1):
        if re.fullmatch(rf"{count:4d}:  ![^;]{{0,32}} ;", line):
            continue
        match = re.fullmatch(rf"{count:4d}:J P\[(\d+)\] (?:10%|(\d+)msec|({NUMBER})sec) FINE ;", line)
        assert match, line
        number, thousandths, seconds = match.groups()
        time = 1e-3 * float(thousandths) if thousandths else float(seconds) if seconds else None
        moves.append((places[int(number)], time))
    assert len(moves) == len(places)
    return moves


def val3_moves(text: str) -> list[tuple[list[float], float | None]]:
    """Return axes [deg] and blend [mm] of every movej of a VAL3 program, None where it stops."""
    space = "{http://www.staubli.com/robotics/VAL3/Program/2}"
    (program,) = ElementTree.fromstring(text.encode())
    assert [one.get("name") for one in program.iter(f"{space}Local")] == ["jPoint", "mDesc"]
    code = [line.split("//")[0].strip() for line in program.find(f"{space}Code").text.splitlines()]
    assert code[0] == "begin" and code[-2:] == ["waitEndMove()", "end"]
    moves: list[tuple[list[float], float | None]] = []
    at, blend = [], None
    for line in filter(None, code[1:-2]):
        if line == "movej(jPoint,flange,mDesc)":
            moves.append((at, blend))
        elif match := re.fullmatch(r"jPoint=\{(.*)\}", line):
            at = [float(x) for x in match[1].split(",")]
            assert len(at) == 6
        elif match := re.fullmatch(rf"mDesc\.leave=({NUMBER})", line):
            blend = float(match[1])
        elif line == "mDesc.blend=off":
            blend = None
        else:
            assert line in ("mDesc.blend=joint", "mDesc.reach=mDesc.leave"), line
    return moves
