"""The page of a run that goes on: what the server answers, and that the page follows the newest
moment.
"""

import http.client
import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from support.browser import browser, needs_chromium
from support.command_line import limslam
from support.drives import FOUR_BEAMS, laps_of_square
from support.inspection import SHORT, short_run, unpacked

from limslam_agent import Mapper, preset
from limslam_agent.inspect import live_page as module
from limslam_agent.inspect.live_page import Controls, Follower, live_page
from limslam_agent.live.orders import Goal, Orders
from limslam_env import NominalNoise


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    monkeypatch.setattr(module, "LEAST_PAUSE", 0.0)
    monkeypatch.setattr(module, "SHARE", 1e9)


class Drive:
    """A mapper that is told a recorded drive, and a follower of it."""

    def __init__(self, page, steps=200):
        self.log = laps_of_square(0.02, laps=0.5)
        self.mapper = Mapper(
            FOUR_BEAMS, preset("consistent", NominalNoise(0.02)), self.log.poses[0]
        )
        self.follower = Follower(page, steps)
        self.done = 0
        self.steps = steps

    def on(self, steps):
        for row in range(self.done, self.done + steps):
            self.mapper.step(self.log.observations[row])
            self.follower.note(self.mapper, [], 0.1 * row, self.log.poses[row][None])
        self.done += steps


def asked(page, path, host=None):
    place = page.address.removeprefix("http://").partition("/")[0]
    connection = http.client.HTTPConnection(place, timeout=30)
    connection.request("GET", path, headers={"Host": place if host is None else host})
    answer = connection.getresponse()
    status = answer.status
    content = answer.read()
    is_over = answer.headers.get("X-Over") == "1"
    connection.close()
    return (
        (status, content.decode(), is_over)
        if path.startswith("/recording")
        else (status, content.decode())
    )


def posted(page, content, *, token=None, path="/order", host="localhost"):
    """The status of the answer to an order."""
    place = page.address.removeprefix("http://").partition("/")[0]
    connection = http.client.HTTPConnection(place, timeout=30)
    headers = {"Host": host, "X-Token": page.token if token is None else token}
    connection.request("POST", path, content, headers)
    status = connection.getresponse().status
    connection.close()
    return status


def controlled(orders):
    state = {"paused": False, "answer": "driving to Gorm \u00e9\n"}
    return live_page("run", controls=Controls(orders.obey, lambda: state))


def test_an_order_is_taken_from_a_page_that_knows_the_token_alone():
    orders = Orders()
    order = json.dumps({"order": "pause"})
    with live_page("run") as page:
        assert "token" not in page.address
        assert posted(page, order) == 404
    with controlled(orders) as page:
        assert page.address.endswith(f"/?token={page.token}")
        for told in ({"token": ""}, {"token": "x" * 22}, {"host": "evil.example"}):
            assert posted(page, order, **told) == 403
        assert posted(page, order, path="/") == 404
        assert not orders.is_paused
        assert posted(page, order) == 200
        assert orders.is_paused
        assert asked(page, "/")[0] == 200


@pytest.mark.parametrize(
    "content", ["", "no JSON", "[" * 900, "[1]", '{"order": "dance"}', f'"{"x" * 2000}"']
)
def test_what_is_no_order_is_refused(content, capfd):
    with controlled(Orders()) as page:
        assert posted(page, content) == 400
    assert capfd.readouterr().err == ""


def test_the_server_answers_its_own_page_alone():
    with live_page("a <run>") as page:
        assert page.address.startswith("http://127.0.0.1:")
        status, text = asked(page, "/")
        assert status == 200
        assert "a &lt;run&gt;" in text
        assert asked(page, "/recording?0") == (200, "", False)
        assert asked(page, "/etc/passwd")[0] == 404


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200),
        ("LocalHost:8080", 200),
        ("127.0.0.1:9", 200),
        ("[::1]:8080", 200),
        ("evil.example:80", 403),
        ("localhost.evil.example", 403),
        ("evil.example:localhost", 403),
        ("127.0.0.1.evil.example:80", 403),
        ("localhost:80@evil.example", 403),
        ("localhost:", 403),
        ("", 403),
    ],
)
def test_names_of_this_computer_are_answered_with_any_port(host, status):
    """A tunnel has a port of its own, and a name of somebody else may be made to lead here."""
    with live_page("run") as page:
        assert asked(page, "/", host=host)[0] == status


@pytest.mark.parametrize("number", ["5" * 5000, "5" * 19, "-1", "1.0", "x", "%31", "1?2"])
def test_what_is_no_number_of_a_state_is_refused(number, capfd):
    with live_page("run") as page:
        assert asked(page, f"/recording?{number}")[0] == 400
    assert capfd.readouterr().err == ""


def test_a_browser_that_closes_its_connection_is_passed_over(capfd):
    begun = (b"GET / HT", b"GET /recording?0 HTTP/1.1\r\nHost: localhost\r\n\r\n")
    with live_page("run") as page:
        port = int(page.address.rstrip("/").rpartition(":")[2])
        count = threading.active_count()
        for request in begun:
            with socket.create_connection(("127.0.0.1", port)) as connection:
                # Closed without a farewell.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                connection.sendall(request)
        assert asked(page, "/")[0] == 200
        page.end()
        while threading.active_count() > count:
            time.sleep(0.01)
    assert capfd.readouterr().err == ""


def test_the_recording_grows():
    edges = np.array([[0.0, 0.0, 1.0, 0.0]])
    with live_page("run", edges) as page:
        drive = Drive(page)
        for frames in (20, 60):
            drive.on(frames - drive.done)
            arrays, meta = unpacked(asked(page, "/recording?0")[1])
            assert len(arrays["time"]) == frames
            assert meta["title"] == "run"
            assert np.allclose(arrays["pose"][-1, 0], drive.mapper.poses[0], atol=1e-5)
            assert np.array_equal(arrays["edges"], edges)
        drive.on(140)
        drive.mapper.finish()
        drive.follower.end()
        _, text, is_over = asked(page, "/recording?3")
        _, meta = unpacked(text)
        assert is_over
        assert all("why" in event for event in meta["events"] if event["kind"] == "waits")
        assert asked(page, f"/recording?{page.newest(0)[0]}") == (200, "", True)


def test_a_run_is_not_changed_by_watching_it(tmp_path, run_folder):
    watched = short_run(tmp_path / "watched", "--watch")
    for name in ("trajectory_est.tum", "map.json", "run.toml"):
        assert (watched / name).read_bytes() == (run_folder / name).read_bytes(), name


def test_the_address_is_printed(tmp_path):
    done = limslam(
        "run", *SHORT, "--max-time", 3, "--robots", 2, "--watch", "--out", tmp_path / "run"
    )
    assert done.returncode == 0
    assert "watch       http://127.0.0.1:" in done.stderr


@needs_chromium
def test_the_page_follows_the_newest_moment():
    with live_page("run") as page, browser() as chromium:
        drive = Drive(page)
        drive.on(30)
        chromium.open(page.address)
        chromium.wait_for("player.recording.frames === 30 && player.frame === 29")
        drive.on(50)
        chromium.wait_for("player.recording.frames === 80 && player.frame === 79")
        grid, cell, bounds = chromium.run(
            "[player.recording.gridOf(79), player.recording.meta.cell, player.scene.bounds]"
        )
        low = np.array([grid["column"], grid["row"]])
        high = low + np.array([grid["columns"], grid["rows"]])
        assert (bounds[:2] <= cell * low).all(), "the whole map is in the picture"
        assert (bounds[2:] >= cell * high).all(), "the whole map is in the picture"
        chromium.page.keyboard.press("Home")
        drive.on(20)
        chromium.wait_for("player.recording.frames === 100")
        assert chromium.run("player.frame") == 0
        chromium.page.keyboard.press("End")
        drive.on(100)
        drive.mapper.finish()
        drive.follower.end()
        chromium.wait_for("document.body.dataset.state === 'over'")
        assert chromium.run("[player.recording.frames, player.frame]") == [200, 199]
        assert "over" in chromium.run("document.getElementById('check').textContent")
        assert chromium.errors == []


@needs_chromium
def test_a_page_gives_orders_and_shows_the_answers():
    orders = Orders()

    def state():
        return {"paused": orders.is_paused, "answer": (orders.answers or [""])[-1]}

    with (
        live_page("run", controls=Controls(orders.obey, state)) as page,
        browser() as chromium,
    ):
        drive = Drive(page)
        drive.on(60)
        chromium.open(page.address.partition("?")[0])
        assert chromium.run("byId('orders').hidden"), "a page without the token gives no orders"
        chromium.open(page.address)
        chromium.wait_for("!byId('orders').hidden")
        chromium.page.click("#order-pause")
        chromium.wait_for("byId('order-pause').textContent === 'Go on'")
        assert "paused" in chromium.page.inner_text("#order-answer")
        chromium.page.click("#order-pause")
        chromium.wait_for("byId('order-pause').textContent === 'Pause'")
        place = drive.mapper.poses[0, :2].tolist()
        chromium.page.keyboard.press("Home")
        chromium.page.click("#order-goal")
        assert chromium.run("player.frame") == 59, "a goal belongs to the newest map"
        low, scale, box = chromium.run(
            "[player.scene.toWorld(byId('belief'), 0, 0), player.scene.scaleOf(byId('belief')), "
            "byId('belief').getBoundingClientRect()]"
        )
        x, y = (box[name] + 1 for name in ("x", "y"))  # inside of the border
        x += scale * (place[0] - low[0])
        y += scale * (low[1] - place[1])
        chromium.page.mouse.click(x, y)
        for _ in range(500):
            chromium.page.wait_for_timeout(20)
            if orders.destination is not None:
                break
        goal = orders.destination
        assert isinstance(goal, Goal)
        assert np.hypot(goal.x - place[0], goal.y - place[1]) < 0.03
        assert goal.map_number == drive.mapper.map_number
        orders.drop_destination("the goal: there is a wall or an obstacle")
        chromium.wait_for("byId('order-answer').textContent.includes('there is a wall')")
        chromium.page.click("#order-home")
        chromium.wait_for("byId('order-answer').textContent === 'driving home'")
        drive.follower.end()
        chromium.wait_for("byId('order-pause').disabled")
        assert chromium.errors == []
