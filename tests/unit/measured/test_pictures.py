"""Cameras and printed boards: what OpenCV projects is fitted to, its pictures are read, and bad input is refused."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from support import servo_arm
from support.effect_arms import quietly
from support.servo_arm import CAMERA, IMAGE, LENS, ServoArm, board_points, declared, pose, turn, written

from armflex import calibrate, load_arm, plan, predict, read_measurements, rehearse, trace
from armflex.arm import Setup
from armflex.declaration import Declaration, read_toml
from armflex.errors import ArmFileError, ArmflexError, ArmflexWarning, TableError, UnsupportedError
from armflex.estimate.robust import huber_weights
from armflex.estimate.view import look
from armflex.measured import pictures
from armflex.plan.drive import write_plan
from armflex.readings import Pixels
from armflex.readings.board import Board, read_board
from armflex.readings.instrument import Instrument
from armflex.readings.lens import projected
from armflex.readings.sighting import Sighting, sighted

pytestmark = pytest.mark.filterwarnings("ignore:soft:armflex.ArmflexWarning")

cv2 = pytest.importorskip("cv2", reason="opencv is an extra")
STANDING = CAMERA.replace("camera_link", "board_link")


def campaign(folder: Path, seed: int, count: int, on_arm: bool = True, **given) -> tuple[ServoArm, Path, Path]:
    """Write an arm without play, and pictures of it."""
    arm = ServoArm.draw(seed, 0.0, on_arm)
    file = declared(folder, CAMERA if on_arm else STANDING)
    q, came = arm.poses(count, seed)
    return arm, file, written(folder, q, arm.pictures(q, came, seed=seed), came, **given)


@pytest.mark.slow
@pytest.mark.parametrize("on_arm", [True, False])
def test_lens_mounting_and_board_are_found_with_the_arm(tmp_path: Path, on_arm: bool) -> None:
    """Nothing of the camera is declared but its board: all of it is found, and other pictures are as predicted."""
    arm, file, rows = campaign(tmp_path, 3, 40, on_arm)
    loaded = load_arm(file)
    found = calibrate(loaded, read_measurements(rows, loaded))
    assert found.scatter == pytest.approx(1.0, abs=0.05)
    lens = found.arm.sensors["cam"]
    std = {one.which.name: one.std for one in found.parameters if one.which.group.kind == "sensor"}
    for name, truth in (("focal", [905.0, 902.0]), ("centre", [651.0, 353.0])):
        off = (lens.of(name, ("x",))[0] - truth) / [std[f"{name} x"], std[f"{name} y"]]
        assert np.abs(off).max() < 4.0 and std[f"{name} x"] < 1.5
    q, came = arm.poses(20, 99)
    more = read_measurements(written(tmp_path, q, arm.pictures(q, came, seed=9), came, "more.csv"), found.arm)
    kind, sigma = predict(found.arm, more).sensors[0]
    read = more.readings.of(Pixels, "cam")
    assert read is not None and sigma is not None
    there = np.isfinite(read.sigma)
    whitened = ((read.values - kind.values) / np.hypot(read.sigma, sigma))[there]
    assert 0.90 < (np.abs(whitened) < 1.96).mean() < 0.98


@pytest.mark.slow
def test_play_is_traced_in_pictures(tmp_path: Path) -> None:
    """A degree of play in servos, named and sized from 60 pictures; the tip is then known where none was taken."""
    arm = ServoArm.draw(1)
    q, came = arm.poses(80, 11)
    corners = arm.pictures(q, came, seed=1)
    file = declared(tmp_path)
    found = trace(load_arm(file), written(tmp_path, q[:60], corners[:60], came[:60])).arm
    play = {one.location.site: abs(one.amplitudes[0]) for one in found.effects if one.law.name == "backlash"}
    assert play["pan"] == pytest.approx(np.radians(1.0), rel=0.05)
    more = read_measurements(written(tmp_path, q[60:], corners[60:], came[60:], "more.csv"), found)
    at, vector = (found.sensors["cam"].of(name, ("",))[0] for name in ("board_at", "board_turn"))
    off = (predict(found, more).position - at) @ turn(vector) - arm.tips(q[60:], came[60:])
    assert np.sqrt((off**2).sum(axis=1).mean()) < 1e-3


@pytest.mark.slow
def test_play_that_is_not_traced_is_an_error_that_a_picture_shares(tmp_path: Path) -> None:
    """A degree of play is no reason to bend lens and links: both are found, and sigma has the play in it."""
    arm = ServoArm.draw(1)
    q, came = arm.poses(70, 101)
    corners = arm.pictures(q, came, seed=1)
    loaded = load_arm(declared(tmp_path))
    found = calibrate(loaded, written(tmp_path, q[:40], corners[:40], came[:40]), anyway=True)
    assert not found.outliers and "standing_off" in [flag.code for flag in found.flags]
    again = quietly(found.write(tmp_path / "fit.toml"))
    assert again.certainty is not None
    stds = {site: std for site, _, std in again.certainty.unexplained}
    assert set(stds) == set(servo_arm.JOINTS) and stds["pan"] == pytest.approx(np.radians(0.5), rel=0.15)
    assert again.sensors["cam"].of("focal", ("",))[0] == pytest.approx([905.0, 902.0], abs=5.0)
    more = read_measurements(written(tmp_path, q[40:], corners[40:], came[40:], "more.csv"), again)
    at, vector = (again.sensors["cam"].of(name, ("",))[0] for name in ("board_at", "board_turn"))
    predicted = predict(again, more)
    off = (predicted.position - at) @ turn(vector) - arm.tips(q[40:], came[40:])
    assert np.sqrt((off**2).sum(axis=1).mean()) < 4e-3
    (kind, sigma), read = predicted.sensors[0], more.readings.of(Pixels, "cam")
    assert sigma is not None and read is not None
    there = np.isfinite(read.sigma)
    assert (np.abs((read.values - kind.values) / np.hypot(read.sigma, sigma))[there] < 1.96).mean() > 0.90


def test_nothing_is_foretold_of_a_camera_that_may_be_anywhere(tmp_path: Path) -> None:
    _, file, rows = campaign(tmp_path, 3, 6)
    arm = load_arm(file)
    assert not predict(arm, rows).sensors
    known = "focal = [905.0, 902.0]\ncentre = [651.0, 353.0]\nanchor = [0.02, 0.0, 0.05]\nmounting = [0.0, 0.0, 0.0]\n"
    known += "board_at = [0.3, 0.0, 0.0]\nboard_turn = [0.0, 3.1, 0.0]\nboard_turn_std = 0.1\n"
    file.write_text(file.read_text().replace("distortion_std = 0.2\n", known))
    assert [kind.name for kind, _ in predict(load_arm(file), rows).sensors] == ["cam"]


def test_an_error_in_pixels_is_said_in_mm_at_the_board(tmp_path: Path) -> None:
    """OpenCV says from the pictures alone how far the corners are; a pixel is so far by the focal length."""
    arm, file, rows = campaign(tmp_path, 3, 6)
    stands = {"anchor": arm.camera[:3, 3], "mounting": cv2.Rodrigues(arm.camera[:3, :3])[0].ravel()}
    stands |= {"board_at": arm.board[:3, 3], "board_turn": cv2.Rodrigues(arm.board[:3, :3])[0].ravel()}
    known = "focal = [905.0, 902.0]\ncentre = [651.0, 353.0]\n"
    known += "".join(f"{name} = {value.tolist()}\n" for name, value in stands.items())
    file.write_text(file.read_text().replace("distortion_std = 0.2\n", known))
    loaded = load_arm(file)
    view = look(Setup(loaded, Instrument()), read_measurements(rows, loaded))
    depths = []
    for picture in arm.pictures(*arm.poses(6, 3), seed=3):
        seen = np.isfinite(picture).all(axis=1)
        _, vector, place = cv2.solvePnP(board_points()[seen], picture[seen], servo_arm.LENS, servo_arm.DISTORTION)
        depths.append((board_points()[seen] @ turn(vector.ravel()).T + place.ravel())[:, 2])
    said = re.fullmatch(r"2 px is (\S+) mm at the target's distance\.", view.at_target(2.0))
    assert said is not None
    assert float(said[1]) == pytest.approx(2e3 * float(np.median(np.concatenate(depths))) / 903.5, rel=0.15)


@pytest.mark.slow
def test_one_lost_corner_is_an_outlier_without_its_picture(tmp_path: Path) -> None:
    arm, file, _ = campaign(tmp_path, 3, 12)
    q, came = arm.poses(12, 3)
    corners = arm.pictures(q, came, seed=3)
    lost = int(np.flatnonzero(np.isfinite(corners[5]).all(axis=1))[2])
    corners[5, lost] += 30.0
    fixed = "focal = [905.0, 902.0]\ncentre = [651.0, 353.0]\ndistortion = [0.06, -0.12, 0.001, -0.0008]\n"
    file.write_text(file.read_text().replace("distortion_std = 0.2\n", fixed))
    (tmp_path / "corners.csv").unlink()
    loaded = load_arm(file)
    found = calibrate(loaded, read_measurements(written(tmp_path, q, corners, came), loaded), anyway=True)
    weights = huber_weights(found.fit.view)[5].reshape(-1, 2)
    assert weights[lost].max() < 0.2 and np.median(weights) == 1.0
    assert found.scatter < 1.2 and [one.which.name for one in found.parameters if "focal" in str(one.which.name)] == []


def test_corners_are_where_opencv_has_them() -> None:
    rng = np.random.default_rng(1)
    there = turn(np.array([0.2, -0.3, 0.4])), np.array([-0.1, -0.05, 0.4])
    own = board_points() @ there[0].T + there[1]
    lens = np.append(rng.normal(0.0, 0.05, 4) * [1.0, 1.0, 0.05, 0.05], 0.02)
    expected = cv2.projectPoints(own, np.zeros(3), np.zeros(3), LENS, lens)[0].reshape(-1, 2)
    focal, centre = np.diag(LENS)[:2], LENS[:2, 2]
    found, _ = projected(own[None], focal[None], centre[None], lens[None])
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


@pytest.mark.parametrize("flat", [True, False])
def test_the_closed_form_is_exact_of_exact_pictures(flat: bool) -> None:
    """Lens, mounting and board of a camera that nothing was known of; one of five pictures is of another pose."""
    rng = np.random.default_rng(2)
    points = board_points()
    points[:, 2] += 0.0 if flat else rng.uniform(0.0, 0.05, len(points))
    eye, board = (pose(turn(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 0.1, 3)) for _ in range(2))
    before = [
        pose(turn(rng.normal(0.0, 0.5, 3)), np.array([-0.1, -0.1, 0.5]) + rng.normal(0, 0.05, 3)) for _ in range(15)
    ]
    links = np.array([board @ np.linalg.inv(eye @ one) for one in before])
    focal, centre = np.full(2, 900.0), 0.5 * np.array(IMAGE, float)
    own = np.array([points @ one[:3, :3].T + one[:3, 3] for one in before])
    corners = own[..., :2] / own[..., 2:] * focal + centre
    links[::5] = np.roll(links[::5], 1, axis=0)
    found = sighted(
        Sighting(points, corners, links, np.array(IMAGE, float)), None if flat else focal, None, np.zeros(5)
    )
    assert found is not None
    np.testing.assert_allclose(found[0], focal, rtol=1e-6)
    for (place, vector), truth in zip((found[2:4], found[4:6]), (eye, board), strict=True):
        np.testing.assert_allclose(place, truth[:3, 3], atol=2e-2)  # closed form, weighed: the fit goes on from here
        np.testing.assert_allclose(turn(vector), truth[:3, :3], atol=5e-2)


def test_a_campaign_may_hold_the_corners_itself(tmp_path: Path) -> None:
    _, file, rows = campaign(tmp_path, 4, 6)
    arm = load_arm(file)
    read = read_measurements(rows, arm)
    table = read.to_frame()
    assert {"cam_u0", "cam_v34", "sigma_cam"} <= set(table.columns) and "cam" not in table
    again = read_measurements(table, arm)
    for one, other in zip(read.readings.kinds, again.readings.kinds, strict=True):
        np.testing.assert_allclose(one.values, other.values)
        np.testing.assert_array_equal(np.isfinite(one.sigma), np.isfinite(other.sigma))
    with pytest.raises(TableError, match="corner 0 of cam has only one of u and v"):
        read_measurements(table.assign(cam_u0=1.0, cam_v0=np.nan), arm)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("rows.csv_0,99,1,2\n", "corner is 99; the board has corners 0 to 34"),
        ("rows.csv_0,0,1,2\nrows.csv_0,0,1,2\n", "corner 0 of picture 'rows.csv_0' stands twice"),
        ("rows.csv_0,0,one,2\n", "not a finite number"),
        ("others.csv_0,0,1,2\n", "has no corners of any picture"),
    ],
)
def test_tables_of_corners_that_cannot_be_read(tmp_path: Path, change: str, said: str) -> None:
    _, file, rows = campaign(tmp_path, 4, 6)
    (tmp_path / "corners.csv").write_text(f"picture,corner,u,v\n{change}")
    with pytest.raises(TableError, match=re.escape(said)):
        read_measurements(rows, load_arm(file))


def test_a_picture_without_a_corner_is_named(tmp_path: Path) -> None:
    _, file, rows = campaign(tmp_path, 4, 6)
    measured = read_measurements(rows, load_arm(file)).measured
    known = (tmp_path / "corners.csv").read_text().splitlines()
    (tmp_path / "corners.csv").write_text("\n".join(one for one in known if not one.startswith("rows.csv_2,")))
    read = read_measurements(rows, load_arm(file))
    assert "rows.csv_2" in next(flag.text for flag in read.flags if flag.code == "picture_without_board")
    assert measured[2] and read.measured.tolist() == (measured & (np.arange(6) != 2)).tolist()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('camera_link = "link_roll"\n', ""), "give the link that the camera is on"),
        (('"link_roll"', '"link_rol"'), "did you mean 'link_roll'"),
        (('"link_roll"', '"base"'), "nothing moves between the two"),
        (('camera_link = "link_roll"', 'board_link = "base"'), "board_link: 'base' is the link itself: nothing moves"),
        (('"charuco"', '"charucco"'), "did you mean 'charuco'"),
        (("columns = 8", "columns = 1"), "the board has 0 points"),
        (("marker = 0.022", "marker = 0.04"), "a marker lies within its square"),
        (("square = 0.03", "square = 30"), "expected a length of the print"),
        (("distortion_std = 0.2", "distortion = [0.1]"), "expected 5 numbers or 4 numbers"),
    ],
)
def test_cameras_that_are_declared_wrongly(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    file = declared(tmp_path)
    assert change[0] in file.read_text()
    file.write_text(file.read_text().replace(*change))
    with pytest.raises(ArmFileError, match=re.escape(said)):
        load_arm(file)


BOARDS = {
    "charuco": 'kind = "charuco", columns = 8, rows = 6, square = 0.03, marker = 0.022',
    "chessboard": 'kind = "chessboard", columns = 8, rows = 5, square = 0.03',
    "even chessboard": 'kind = "chessboard", columns = 7, rows = 5, square = 0.03',
    "apriltag": 'kind = "apriltag", columns = 4, rows = 3, tag = 0.04, gap = 0.012',
    "circles": 'kind = "circles", columns = 7, rows = 5, spacing = 0.03',
    "asymmetric_circles": 'kind = "asymmetric_circles", columns = 4, rows = 7, spacing = 0.02',
}


def board_of(folder: Path, text: str) -> Board:
    file = folder / "board.toml"
    file.write_text(f"board = {{ {text} }}\n")
    root: Declaration = read_toml(file)
    return read_board(root.sub("board"))


def printed(board: Board, scale: float = 4000.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the print of a board, and the (3, 3) map from its frame [m] to the pixels of the print."""
    margin = 120
    if board.kind in ("charuco", "apriltag"):
        number = getattr(cv2.aruco, f"DICT_{board.dictionary}")
        size, markers = (board.columns, board.rows), cv2.aruco.getPredefinedDictionary(number)
        kind = cv2.aruco.CharucoBoard if board.kind == "charuco" else cv2.aruco.GridBoard
        made = kind(size, *board.lengths, markers)
        across = np.array(made.getRightBottomCorner()[:2]) * scale
        drawn = made.generateImage(tuple(np.round(across).astype(int).tolist()), marginSize=0)
        drawn = cv2.copyMakeBorder(drawn, *[margin] * 4, cv2.BORDER_CONSTANT, value=255)
    else:
        extent = board.points.max(axis=0)[:2] * scale
        pitch = int(board.lengths[0] * scale)
        drawn = np.full(
            (int(extent[1]) + 2 * margin + 2 * pitch, int(extent[0]) + 2 * margin + 2 * pitch), 255, np.uint8
        )
        margin += pitch
        if board.kind == "chessboard":
            for i in range(-1, board.columns):
                for j in range(-1, board.rows):
                    if (i + j) % 2:
                        x, y = margin + i * pitch, margin + j * pitch
                        drawn[y : y + pitch, x : x + pitch] = 0
        else:
            for x, y, _ in board.points * scale:
                cv2.circle(drawn, (round(x) + margin, round(y) + margin), pitch // 3, 0, -1, cv2.LINE_AA)
    middle = margin - (0.5 if board.kind != "circles" and "asym" not in board.kind else 0.0)
    return drawn, np.array([[scale, 0.0, middle], [0.0, scale, middle], [0.0, 0.0, 1.0]])


def photographed(board: Board, there: np.ndarray, file: Path) -> np.ndarray:
    """Write a picture of a board at a pose before the camera, without distortion; return its (C, 2) corners [px]."""
    drawn, at = printed(board)
    seen = LENS @ np.column_stack([there[:3, 0], there[:3, 1], there[:3, 3]])
    picture = cv2.warpPerspective(drawn, seen @ np.linalg.inv(at), IMAGE, flags=cv2.INTER_AREA, borderValue=200)
    cv2.imwrite(str(file), cv2.GaussianBlur(picture, (3, 3), 0.7))
    own = (board.points @ there[:3, :3].T + there[:3, 3]) @ LENS.T
    return own[:, :2] / own[:, 2:]


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(BOARDS))
def test_boards_are_found_in_pictures(tmp_path: Path, kind: str) -> None:
    """Every kind of print, by number, to a few tenths of a pixel."""
    board = board_of(tmp_path, BOARDS[kind])
    turned = [] if board.alike else [[0.1, 0.0, 2.6]]
    for i, vector in enumerate([[0.0, 0.0, 0.0], [0.4, 0.1, 0.05], [-0.2, 0.5, -0.1], *turned]):
        middle = board.points.mean(axis=0)
        axes = turn(np.array(vector))
        expected = photographed(board, pose(axes, np.array([0.01, 0.0, 0.45]) - axes @ middle), tmp_path / f"{i}.png")
        found = pictures.find_corners(tmp_path / f"{i}.png", board)
        assert found is not None
        off = np.linalg.norm(found.reshape(-1, 2) - expected, axis=1)
        assert np.isfinite(off).mean() > 0.9
        # A tag's corners are no saddle points: OpenCV has them nearer to its middle than they are.
        assert np.nanmedian(off) < (0.5 if kind == "apriltag" else 0.3) and np.nanmax(off) < 1.5, kind


def test_pictures_are_read_where_the_campaign_names_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board = board_of(tmp_path, BOARDS["charuco"])
    middle = board.points.mean(axis=0)
    expected = photographed(board, pose(np.eye(3), np.array([0.0, 0.0, 0.4]) - middle), tmp_path / "a.png")
    cv2.imwrite(str(tmp_path / "b.png"), np.full(IMAGE[::-1], 128, np.uint8))
    (tmp_path / "c.png").write_text("no picture")
    file = declared(tmp_path, CAMERA.replace('corners = "corners.csv"\n', ""))
    head = ",".join(f"q_{joint}" for joint in servo_arm.JOINTS) + ",cam\n"
    rows = tmp_path / "rows.csv"
    rows.write_text(f"{head}0,0,0,0,0,a.png\n0,0,0,0,0,b.png\n0,0,0,0,0,\n")
    read = read_measurements(rows, load_arm(file))
    kind = read.readings.of(Pixels, "cam")
    assert kind is not None and read.measured.tolist() == [True, False, False]
    assert np.abs(kind.values[0].reshape(-1, 2) - expected).max() < 1.0
    assert "b.png" in next(flag.text for flag in read.flags if flag.code == "picture_without_board")
    for cell, said in (("c.png", "is no picture"), ("d.png", "there is no picture")):
        rows.write_text(f"{head}0,0,0,0,0,{cell}\n")
        with pytest.raises(TableError, match=said):
            read_measurements(rows, load_arm(file))
    monkeypatch.setitem(sys.modules, "cv2", None)
    pictures.find_corners.cache_clear()
    rows.write_text(f"{head}0,0,0,0,0,a.png\n")
    with pytest.raises(UnsupportedError, match=re.escape("pip install 'armflex[camera]'")):
        read_measurements(rows, load_arm(file))


@pytest.mark.slow
def test_rows_are_planned_after_pictures(tmp_path: Path) -> None:
    """Pictures of before count as known, and the plan's file has a column for those that are to be taken."""
    machine, file, rows = campaign(tmp_path, 3, 30)
    loaded = load_arm(file)
    found = calibrate(loaded, read_measurements(rows, loaded)).arm
    chosen = plan(found, 4, after=read_measurements(rows, found), instruments=["cam"], seed=1)
    write_plan(chosen, tmp_path / "plan.csv")
    header, *lines = (tmp_path / "plan.csv").read_text().splitlines()
    assert "cam" in header.split(",") and len(lines) >= 4
    read = chosen.rows.q[chosen.rows.measured]
    assert len(read) == 4
    assert np.isfinite(machine.pictures(read, noise=0.0)).any(axis=(1, 2)).all()  # the board is in every picture
    with pytest.warns(ArmflexWarning, match="may be anywhere"), pytest.raises(ArmflexError):
        rehearse(loaded, {})
