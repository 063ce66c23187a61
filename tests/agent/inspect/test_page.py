"""The page in a headless Chromium: every control does what it says, nothing is asked from a network, no errors."""

import json

import numpy as np
import pytest
from support.browser import CHROMIUM, browser
from support.inspection import data_in, inspected, short_run, unpacked

from limslam_agent.video.belief_frame import hough_image

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium")

FRAME = "player.frame"


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture
def opened(chromium, page):
    chromium.errors.clear()
    chromium.requests.clear()
    chromium.open(page)
    yield chromium
    assert chromium.errors == []
    assert chromium.requests == []


def text(opened, name):
    return opened.run(f"document.getElementById({json.dumps(name)}).textContent")


def picture_of(opened, name):
    return opened.run(f"document.getElementById({json.dumps(name)}).toDataURL()")


def test_the_page_begins_at_the_start_and_shows_both_pictures(opened):
    assert opened.run(FRAME) == 0
    for name in ("truth", "belief"):
        canvas = f"document.getElementById('{name}')"
        pixels = f"{canvas}.getContext('2d').getImageData(0, 0, {canvas}.width, {canvas}.height).data.buffer"
        colours = opened.run(f"new Set(new Uint32Array({pixels})).size")
        assert colours > 20, name
    assert opened.run("document.querySelectorAll('#plots .uplot').length") == 4
    assert text(opened, "title").startswith("square")


@pytest.mark.parametrize(("width", "height"), [(360, 740), (1440, 900)])
def test_nothing_is_wider_than_the_window(opened, width, height):
    opened.resize(width, height)
    opened.wait_for(f"innerWidth === {width}")
    assert opened.run("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(
    ("key", "shift", "expected"),
    [
        ("ArrowRight", False, "51"), ("ArrowLeft", False, "49"), ("ArrowRight", True, "60"), ("ArrowLeft", True, "40"),
        ("Home", False, "0"), ("End", False, "player.recording.frames - 1"),
        ("PageDown", False, "player.recording.frameAt(player.list.beside(50, 1).t + 1e-3)"),
        ("PageUp", False, "player.recording.frameAt(player.list.beside(50, -1).t + 1e-3)"),
    ],
)  # fmt: skip
def test_keys_step(opened, key, shift, expected):
    opened.run("player.stopAt(50)")
    expected = opened.run(expected)
    opened.press(key, shift=shift)
    assert opened.run(FRAME) == expected


def test_play_and_pause(opened):
    opened.run("player.goTo(0)")
    opened.press(" ")
    assert opened.run("player.isPlaying")
    assert opened.run("document.getElementById('play').getAttribute('aria-label')") == "Pause"
    opened.wait_for("player.frame > 3")
    opened.click("#play")
    assert not opened.run("player.isPlaying")
    stopped = opened.run(FRAME)
    opened.run("new Promise((done) => setTimeout(done, 100))")
    assert opened.run(FRAME) == stopped
    opened.run("player.stopAt(player.recording.frames - 3)")
    opened.click("#play")
    opened.wait_for("!player.isPlaying")
    assert opened.run("player.frame === player.recording.frames - 1")


def test_the_slider_scrubs(opened):
    opened.run("const s = document.getElementById('slider'); s.value = 77; s.dispatchEvent(new Event('input'))")
    assert opened.run(FRAME) == 77
    assert text(opened, "clock") == "7.7 s"
    assert opened.run("document.getElementById('slider').getAttribute('aria-valuetext')") == "7.7 s"


def test_a_link_opens_its_moment(chromium, page):
    chromium.open(page, fragment="#t=12.3")
    assert chromium.run("player.recording.seconds[player.frame]") == pytest.approx(12.3)
    chromium.run("location.hash = '#t=4.5'")
    chromium.wait_for("Math.abs(player.recording.seconds[player.frame] - 4.5) < 1e-6")
    chromium.press("ArrowRight")
    assert chromium.run("location.hash") == "#t=4.6"
    chromium.click("#link")
    chromium.wait_for("document.getElementById('link').textContent === 'Copied'")


@pytest.mark.parametrize("layer", ["grid", "beams", "smoothed"])
def test_each_layer_changes_the_picture(opened, layer):
    opened.run("player.stopAt(200)")
    before = picture_of(opened, "belief")
    opened.click(f"#layers input[data-layer='{layer}']")
    changed = picture_of(opened, "belief")
    assert changed != before
    opened.click(f"#layers input[data-layer='{layer}']")
    assert picture_of(opened, "belief") == before


def test_zoom_follow_and_fit(opened):
    opened.run("player.stopAt(100)")
    opened.click("#zoom-in")
    assert opened.run("player.scene.zoom") == pytest.approx(1.4)
    opened.click("#zoom-out")
    assert opened.run("player.scene.zoom") == pytest.approx(1.0)
    opened.click("#follow")
    pose = opened.run("player.recording.poseOf('pose', player.frame, 0)")
    assert opened.run("player.scene.centre") == pytest.approx(pose[:2])
    opened.click("#fit")
    assert opened.run("[player.scene.zoom, player.scene.follows]") == [1, False]


def test_the_panels_tell_the_moment(opened):
    opened.run("document.querySelectorAll('.panels details').forEach((panel) => { panel.open = true; })")
    event = opened.run("player.recording.events.find(({kind, tests}) => kind === 'again' && tests.length > 1)")
    opened.run(f"player.seek({event['t']} + 1e-3)")
    opened.wait_for("document.querySelector('#readings table') !== null")
    latest = opened.run("player.recording.latest(player.frame, ({kind}) => DECISIONS.has(kind))")
    rows = opened.run("[...document.querySelectorAll('#decision table')][0].rows.length")
    assert rows == len(latest["tests"]) + 2
    assert opened.run("document.querySelectorAll('#readings tbody tr').length") == 6
    assert opened.run("document.querySelectorAll('#frontiers tbody tr').length") >= 1
    assert "error of position" in text(opened, "moment")
    assert "votes" in text(opened, "hough-words")


def test_the_votes_are_those_of_the_films(opened, page):
    _, meta = unpacked(data_in(page))
    event = next(event for event in meta["events"] if event["kind"] == "hough" and len(event["points"]) > 40)
    points = np.array(event["points"]).reshape(-1, 2) / 1000.0
    expected, reach = hough_image(points - points.mean(axis=0), max(event["r_step"], 0.02))
    told = {"points": event["points"], "r_step": event["r_step"]}
    found = opened.run(
        f"(() => {{ const v = votesOf({json.dumps(told)}); return [[...v.votes], v.rows, v.reach]; }})()"
    )
    assert found[2] == pytest.approx(reach)
    votes = np.array(found[0]).reshape(found[1], -1)
    assert votes.shape == expected.shape
    # A point in the middle between two bins may be rounded to either of them.
    assert np.abs(votes - expected).sum() <= 0.001 * expected.sum()


def test_grids_and_errors_are_restored(opened, page):
    arrays, _ = unpacked(data_in(page))
    cells = {}
    frame = 150
    for row, column, length, kind in arrays["grid"][: arrays["grid_starts"][frame + 1]].tolist():
        cells.update({(row, place): kind for place in range(column, column + length)})
    opened.run("player.stopAt(player.recording.frames - 1); player.stopAt(150)")
    found = opened.run(
        "(() => { const g = player.recording.gridOf(150); return [g.row, g.column, g.columns, [...g.kinds]]; })()"
    )
    low, left, columns, kinds = found
    shown = {(low + at // columns, left + at % columns): kind for at, kind in enumerate(kinds) if kind}
    assert shown == {place: kind for place, kind in cells.items() if kind}
    off = arrays["pose"][frame, 0, :2] - arrays["true"][frame, 0, :2]
    assert opened.run("player.recording.errors(150, 0).position_error") == pytest.approx(np.hypot(*off), rel=1e-5)


@pytest.mark.parametrize("options", [("--robots", 2), ("--preset", "paper")])
def test_pages_of_other_runs(chromium, tmp_path, options):
    folder = short_run(tmp_path / "run", "--max-time", 8, *options)
    assert inspected(folder, tmp_path / "page.html").returncode == 0
    chromium.errors.clear()
    chromium.open(tmp_path / "page.html", fragment="#t=6")
    chromium.run("document.querySelectorAll('.panels details').forEach((panel) => { panel.open = true; })")
    chromium.press("End")
    robots = chromium.run("player.recording.robots")
    assert chromium.run("document.getElementById('whose').hidden") == (robots == 1)
    before = chromium.run("player.plots.columns.position.slice(-1)[0]")
    chromium.run(
        "const r = document.getElementById('robot'); r.value = r.options.length - 1;"
        " r.dispatchEvent(new Event('change'))"
    )
    assert (chromium.run("player.plots.columns.position.slice(-1)[0]") == before) == (robots == 1)
    assert chromium.errors == []


def test_the_page_of_a_log_shows_the_belief_alone(chromium, tmp_path, run_folder):
    arrays = dict(np.load(run_folder / "log.npz"))
    for name in ("true_pose", "wall_seen"):
        del arrays[name]
    np.savez(tmp_path / "log.npz", **arrays)
    assert inspected(tmp_path / "log.npz", tmp_path / "page.html").returncode == 0
    chromium.errors.clear()
    chromium.open(tmp_path / "page.html")
    chromium.press("End")
    assert chromium.run("document.getElementById('truth')") is None
    assert chromium.run("document.querySelectorAll('#plots .uplot').length") == 3
    assert chromium.errors == []


def test_a_damaged_page_says_so(chromium, page, tmp_path):
    broken = tmp_path / "page.html"
    content = page.read_text(encoding="utf-8")
    broken.write_text(content.replace(data_in(page), data_in(page)[: len(data_in(page)) // 8 * 4]), encoding="utf-8")
    chromium.open(broken)
    assert chromium.run("document.body.dataset.state") == "failed"
    assert "cannot be shown" in text(chromium, "loading")
    chromium.errors.clear()
