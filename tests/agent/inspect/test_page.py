"""The page in a headless Chromium: every control does what it says, nothing is asked from a
network, no errors.
"""

import json

import numpy as np
import pytest
from support.browser import needs_chromium
from support.inspection import data_in, inspected, unpacked

from limslam_agent.video.belief_frame import hough_image

pytestmark = needs_chromium

FRAME = "player.frame"


@pytest.fixture
def opened(chromium, page):
    chromium.open(page)
    yield chromium
    assert chromium.errors == []
    assert chromium.requests == []


def text(opened, name):
    return opened.run(f"document.getElementById({json.dumps(name)}).textContent")


def test_the_page_begins_at_the_start_and_shows_both_pictures(opened):
    assert opened.run(FRAME) == 0
    for name in ("truth", "belief"):
        canvas = f"document.getElementById('{name}')"
        pixels = (
            f"{canvas}.getContext('2d').getImageData(0, 0, {canvas}.width, "
            f"{canvas}.height).data.buffer"
        )
        colours = opened.run(f"new Set(new Uint32Array({pixels})).size")
        assert colours > 20, name
    assert opened.run("document.querySelectorAll('#plots .uplot').length") == 4
    assert text(opened, "title").startswith("square")


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("ArrowRight", "51"),
        ("ArrowLeft", "49"),
        ("Shift+ArrowRight", "60"),
        ("Shift+ArrowLeft", "40"),
        ("Home", "0"),
        ("End", "player.recording.frames - 1"),
        ("PageDown", "player.recording.frameAt(player.list.beside(50, 1).t + 1e-3)"),
        ("PageUp", "player.recording.frameAt(player.list.beside(50, -1).t + 1e-3)"),
    ],
)
def test_keys_step(opened, key, expected):
    opened.run("player.stopAt(50)")
    expected = opened.run(expected)
    opened.page.keyboard.press(key)
    assert opened.run(FRAME) == expected


def test_the_panels_tell_the_moment(opened):
    opened.run(
        "document.querySelectorAll('.panels details').forEach((panel) => { panel.open = true; })"
    )
    event = opened.run(
        "player.recording.events.find(({kind, tests}) => kind === 'again' && tests.length > 1)"
    )
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
    event = next(
        event for event in meta["events"] if event["kind"] == "hough" and len(event["points"]) > 40
    )
    points = np.array(event["points"]).reshape(-1, 2) / 1000.0
    expected, reach = hough_image(points - points.mean(axis=0), max(event["r_step"], 0.02))
    told = {"points": event["points"], "r_step": event["r_step"]}
    found = opened.run(
        f"(() => {{ const v = votesOf({json.dumps(told)}); return [[...v.votes], v.rows, "
        "v.reach]; })()"
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
        "(() => { const g = player.recording.gridOf(150); return [g.row, g.column, g.columns, "
        "[...g.kinds]]; })()"
    )
    low, left, columns, kinds = found
    shown = {
        (low + at // columns, left + at % columns): kind for at, kind in enumerate(kinds) if kind
    }
    assert shown == {place: kind for place, kind in cells.items() if kind}
    off = arrays["pose"][frame, 0, :2] - arrays["true"][frame, 0, :2]
    assert opened.run("player.recording.errors(150, 0).position_error") == pytest.approx(
        np.hypot(*off), rel=1e-5
    )


def test_the_page_of_a_log_shows_the_belief_alone(chromium, tmp_path, run_folder):
    arrays = dict(np.load(run_folder / "log.npz"))
    for name in ("true_pose", "wall_seen"):
        del arrays[name]
    np.savez(tmp_path / "log.npz", **arrays)
    assert inspected(tmp_path / "log.npz", tmp_path / "page.html").returncode == 0
    chromium.open(tmp_path / "page.html")
    chromium.page.keyboard.press("End")
    assert chromium.run("document.getElementById('truth')") is None
    assert chromium.run("document.querySelectorAll('#plots .uplot').length") == 3
    assert chromium.errors == []
