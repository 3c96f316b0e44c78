"""The page of a traced arm: what it says, that names cannot harm it, and that it stands alone."""

import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from support.campaigns import draw
from support.pages import BROWSER, sheets

import armflex
from armflex.conventions import number
from armflex.laws.effects.gear_harmonic import GEAR_HARMONIC
from armflex.show.report import render_report, write_report
from armflex.show.report.accuracy import Errors
from armflex.show.report.effect_figures import wave
from armflex.show.report.summary import further, headline
from armflex.show.report.svg import canvas, drawing, inline, label
from armflex.show.report.words import called, change, labelled, measure, millimetres, short
from armflex.trace import trace
from armflex.trace.averaging import alone
from armflex.trace.findings import Trace, Unexplained
from armflex.trace.state import begin

pytestmark = pytest.mark.slow

EVIL = "<script>alert(1)</script>"
SECTIONS = (
    "errors",
    "words",
    "before-and-after",
    "where",
    "left",
    "zeros",
    "parameters",
    "not-told",
    "next",
    "campaign",
    "swing",
    "points",
)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    """A link that grows with a temperature; column, poses and sessions have names that a page must not believe."""
    folder = tmp_path_factory.mktemp("report")
    truth = draw("thermal_growth", 5, arm="six").write(folder)
    header, *rows = truth.train.read_text().splitlines()
    header = header.replace("temperature", f"temp {EVIL} $x^2$")
    rows = [re.sub(r"^(p\d+),(s\d+)", rf"\1{EVIL},<b>\2</b>", row) for row in rows]
    truth.train.write_text("\n".join([header, *rows]) + "\n")
    arm = armflex.load_arm(truth.arm)
    measurements = armflex.read_measurements(truth.train, arm)
    return trace(arm, measurements)


@pytest.fixture(scope="module")
def page(found: Trace) -> str:
    return render_report(found)


def without_effects(found: Trace, unexplained: Unexplained | None = None) -> Trace:
    """The same trace as if nothing had been found."""
    state = begin(found.calibration)
    return replace(found, found=(), predicted=alone(state), unexplained=unexplained)


class Outline(HTMLParser):
    """Text and elements of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.pieces: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.pieces.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.pieces))


def test_first_sentence_names_effect_place_value_and_error(found: Trace, page: str) -> None:
    assert found.found[0].effect.law.name == "thermal_growth"
    text = Outline(page).text
    assert re.search(r"Identified: thermal growth at the link ending at J4: alpha .* ± .* ppm/K\.", text)
    before, after = (f"{1e3 * value:.2f} mm" for value in (found.held_out_before, found.held_out_after))
    assert f"Error on held-out poses: {before} → {after} (noise as stated: 0.35 mm)." in text


def test_every_section_and_figure_is_there(page: str) -> None:
    outline = Outline(page)
    ids = {attributes.get("id") for tag, attributes in outline.tags if tag == "section"}
    assert ids == {*SECTIONS, "kinds", "effect-1"}
    assert sum(tag == "svg" for tag, _ in outline.tags) == 9


def test_the_cover_says_what_a_boss_and_a_metrologist_ask_for(page: str) -> None:
    cover = Outline(page[page.index('class="cover"') : page.index('<section id="before-and-after"')]).text
    for word in (
        "RMS",
        "95 % are below",
        "maximum",
        "as declared, the instrument and target placed",
        "noise as stated",
        "Signature",
    ):
        assert word in cover
    assert re.search(r"Date of the campaign not recorded.* Instruments position, \d+ rows, stated σ .* mm", cover)
    assert re.search(r"Made with armflex \S+, Pinocchio \S+, NumPy \S+, Python", cover)


def test_points_stand_worst_first(page: str) -> None:
    rows = re.findall(r'<tr( class="worst")?>(<td>.*?)</tr>', page[page.index('<section id="points"') :])
    now = [float(re.findall(r"<td>(.*?)</td>", cells)[5]) for _, cells in rows]
    assert len(now) > 30 and now == sorted(now, reverse=True)
    marked = [bool(mark) for mark, _ in rows]
    assert marked == sorted(marked, reverse=True) and 0 < sum(marked) <= 0.06 * len(marked)


@pytest.mark.skipif(BROWSER is None, reason="needs chromium or google-chrome")
def test_the_cover_prints_as_one_sheet(page: str, tmp_path: Path) -> None:
    assert sheets(page, tmp_path / "all") > 2
    assert sheets(page.replace("</style>", "main > :not(.cover) { display: none; }</style>"), tmp_path / "cover") == 1


def test_a_wave_has_amplitude_and_phase(found: Trace) -> None:
    """Of A sin kq + B cos kq the amplitude is the length of (A, B), the phase its direction; neither is of others."""
    assert wave(found, 0) == ()
    one, names = found.found[0], ("A", "B", "k")
    std = {"A": one.std[next(iter(one.std))], "B": 0.0}
    location = replace(one.effect.location, axis="rz", terms=(0, 1))
    effect = replace(one.effect, law=GEAR_HARMONIC, location=location, values=(3e-3, 4e-3, 2.0))
    assert tuple(effect.named) == names
    several = replace(found, found=(replace(one, effect=effect, std=std),))
    said = dict(text.split(" = ") for text in wave(several, 0))
    assert said["amplitude"].startswith("5") and "mrad of C sin(kq + phase)" in said["amplitude"]
    assert said["phase"].startswith("+53") and said["phase"].endswith("°") and said["k"].startswith("2")


def test_a_calibration_has_its_page(found: Trace, tmp_path: Path) -> None:
    text = write_report(found.calibration, tmp_path / "calibration.html").read_text()
    said = Outline(text).text
    assert re.search(r"3-D position error: .* mm as declared, .* mm calibrated \(RMS, poses held out\)", said)
    assert re.search(r"joint_offset J\d [+−][\d.]+ ± [\d.]+ (mrad|µrad)", said)
    assert re.search(r"compliance J\d r\w ×[\d.]+ ± [\d.]+ [\d.]+ ± [\d.]+ [kMG]?Nm/rad", said)
    assert "//" not in text.replace("http://www.w3.org", "").split("<style>")[0] and EVIL not in text


def test_page_stands_alone(page: str) -> None:
    assert "http" not in page and "//" not in re.sub(r"</", "", page)
    asked = [value for _, attributes in Outline(page).tags for name, value in attributes.items() if name in ("src",)]
    links = [a["href"] for tag, a in Outline(page).tags if "href" in a]
    assert not asked and all(link.startswith("#") for link in links)
    assert not re.search(r"@import|@font-face", page)
    assert len(page.encode()) < 3_000_000


def test_names_are_escaped(page: str) -> None:
    assert "<script" not in page and "<b>s" not in page
    text = Outline(page).text
    assert f"temp {EVIL} $x^2$" in text  # axis label of the effect's figure: shown as it is, no formula


def test_ids_of_figures_do_not_clash(page: str) -> None:
    ids = [attributes["id"] for _, attributes in Outline(page).tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(ids)


def test_page_is_written_whole_or_not_at_all(found: Trace, page: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    assert write_report(found, path) == path and path.read_text() == page
    broken = replace(found, places=None)
    with pytest.raises(TypeError):
        write_report(broken, path)
    assert path.read_text() == page and [file.name for file in tmp_path.iterdir()] == ["report.html"]


def test_nothing_missing_says_what_would_have_shown(found: Trace) -> None:
    outline = Outline(render_report(without_effects(found)))
    assert "No further effect is observable in this campaign." in outline.text
    assert "The smallest effect that this campaign would have shown:" in outline.text
    assert "Error before" not in outline.text
    assert not any(attributes.get("id") == "effect-1" for _, attributes in outline.tags)


def test_unexplained_says_place_and_size(found: Trace) -> None:
    left = Unexplained("J2", "ry", 1.5e-4, "rad", 4e-4)
    text = Outline(render_report(without_effects(found, left))).text
    assert "Something moves this arm that no recorded column explains; it acts at J2 (ry), 0.15 mrad." in text
    assert "0.40 mm RMS at the target" in text and "No further effect" not in text


def test_unexplained_without_a_place(found: Trace) -> None:
    said = further(without_effects(found, Unexplained(None, None, None, None, 4e-4)))
    assert "Left unexplained: 0.40 mm RMS at the target, at no particular joint." in said


def test_equivalents_are_said_first_and_the_next_measurement_is_listed(found: Trace) -> None:
    hypothesis = replace(found.found[0].effect, location=replace(found.found[0].effect.location, site="link:J5"))
    told = replace(found, found=(replace(found.found[0], credible=((hypothesis, 0.1),)),))
    page = render_report(replace(told, next_measurement=("Measure <warm> & cold.",)))
    text = Outline(page).text
    said = (
        "These data do not distinguish thermal growth at the link ending at J4 "
        "from thermal growth at the link ending at J5."
    )
    assert 0 < text.index(said) < text.index("Before and after")
    assert "<li>Measure &lt;warm&gt; &amp; cold.</li>" in page


def test_importing_the_package_imports_no_drawing() -> None:
    code = "import sys, armflex.show.report; print([m for m in ('matplotlib', 'jinja2') if m in sys.modules])"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=600).stdout
        == "[]\n"
    )


def test_colours_follow_the_theme() -> None:
    with drawing():
        figure, (panel,) = canvas(2.0, 2.0)
        panel.set_title("fill: #010101")
        svg = inline(figure, "a figure")
    assert "var(--ink)" in svg and not re.search(r'style="[^"]*#0[1-8]0[1-8]0[1-8]', svg)
    assert "fill: #010101" in svg  # somebody's name for a thing


def test_no_name_in_a_figure_is_on_another() -> None:
    places = {"mount": (1.0, 1.0), "released": (1.0, 1.0), "wall_approach": (0.99, 1.0), "corner": (1.0, 0.97)}
    with drawing():
        figure, (panel,) = canvas(4.0, 3.0)
        panel.plot([0.0, 1.0], [0.0, 1.0])
        label(panel, list(places.items()))
        figure.draw_without_rendering()
        boxes = [Text.get_window_extent(text) for text in panel.texts]
    assert [text.get_text() for text in panel.texts] == list(places)
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))


@pytest.mark.parametrize(
    ("value", "std", "unit", "shown"),
    [
        (1.00341e-3, 1.29e-5, "rad", "1.003 ± 0.013 mrad"),
        (-3.5871e-4, 7.4e-6, "m", "−0.359 ± 0.007 mm"),
        (-4.55e-5, 1.09e-6, "1/K", "−45.5 ± 1.1 ppm/K"),
        (6.03e-4, 4.6e-6, "1", "603 ± 5 ppm"),
        (-1.874e-11, 7.2e-13, "rad/Nm^2", "−18.7 ± 0.7 prad/Nm²"),
        (74.2, 6.83, "N/m", "74 ± 7 N/m"),
        (2.5e7, 3e5, "N/m", "(2.50 ± 0.03) × 10⁷ N/m"),
        (19.907, None, "degC", "19.9 °C"),
        (3.0, None, "as recorded", "3"),
        (0.0, 0.0, "rad", "0 rad"),
        (-2.772e-9, 0.0, "m/Nm", "−2.77 nm/Nm"),
    ],
)
def test_measure(value: float, std: float | None, unit: str, shown: str) -> None:
    assert measure(value, std, unit) == shown


def test_lengths() -> None:
    assert millimetres(3.6e-4) == "0.36 mm" and millimetres(None) == "–" and millimetres(7.0e-5) == "0.070 mm"
    assert change(3.73e-4, 3.65e-4) == "0.37 mm → 0.36 mm" and change(3.74e-4, 3.71e-4) == "0.374 mm → 0.371 mm"
    assert (short(1880.8), short(12.04), short(0.0)) == ("1881", "12.0", "0")


def test_rms_uncertainty_takes_poses_as_independent() -> None:
    rng = np.random.default_rng(0)
    poses, each = 400, 5
    squares = np.repeat(rng.exponential(1.0, poses), each)
    errors = Errors(squares, np.repeat(np.arange(poses), each))
    assert errors.std == pytest.approx(0.5 / np.sqrt(poses), rel=0.15)  # as if there were 400 readings, not 2000
    assert np.isnan(errors.of(np.arange(each * poses) < each).std)


def test_every_law_has_words(found: Trace) -> None:
    from armflex.laws.effects.catalogue import EVERY

    assert all(law.words.title and law.words.meaning and law.words.formula for law in EVERY.values())
    effect = found.found[0].effect
    assert called(effect) == "thermal growth at the link ending at J4" and labelled(effect) == "thermal_growth link:J4"


def test_of_many_effects_the_first_two_make_the_headline():
    from types import SimpleNamespace

    from armflex.laws.effects import CATALOGUE, Effect, Location

    law = CATALOGUE["backlash"]
    effects = [Effect(law, Location(f"A{i}", "ry", (f"approach_A{i}",)), (1e-3,)) for i in range(1, 5)]
    found = tuple(SimpleNamespace(effect=effect, number=1, std={"gap": 1e-5}) for effect in effects)
    said = headline(SimpleNamespace(named=found, undecided=None, unfinished=False))
    assert said == "4 effects identified, first of all backlash at A1 (ry) and backlash at A2 (ry)."
    assert "; and " in headline(SimpleNamespace(named=found[:2], undecided=None, unfinished=False))


@pytest.mark.parametrize("rounding", [-3.9e-30, 2e-16, -1e-13])
def test_rounding_is_shown_as_nothing(rounding: float) -> None:
    """Millimetres and milliradians; a compliance has no such size below which it is nothing."""
    assert number(1e3 * rounding) == short(1e3 * rounding) == "0"
    assert millimetres(rounding) == "0 mm" and measure(rounding, None, "m") == "0 m"
    assert measure(rounding, None, "m/N") not in ("0 m/N", "0") and number(rounding, 2, 0.0) == f"{rounding:.2g}"
    assert number(1e3 * 3.9e-12, 2) == "3.9e-09"
