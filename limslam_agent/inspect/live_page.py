"""Shows a recording in a browser while it grows: a server for this computer alone."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.inspect.columns import packed
from limslam_agent.inspect.page import empty_page, told_to_page
from limslam_agent.inspect.recorder import Recorder
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.policies.policy import Policy
from limslam_env.geometry import FloatArray

HOST = "127.0.0.1"
"""The server answers this computer alone."""

LEAST_PAUSE = 1.0
"""Least time between two states of the recording, s."""

SHARE = 0.05
"""Largest share of the time of a run that goes into the states of its recording."""

_PATIENCE = 10.0
"""Seconds after which the page is told that nothing new has come, so that a closed page is noticed."""


class LivePage:
    """The latest state of a recording, for any number of pages that show it.

    Attributes
    ----------
    address
        Where the page is.
    """

    def __init__(self, title: str, address: str, edges: FloatArray | None = None) -> None:
        self.title, self.address = title, address
        self._fixed = {} if edges is None else {"edges": edges.astype(np.float32)}
        self._changed = threading.Condition()
        self._state: tuple[dict[str, NDArray[Any]], dict[str, Any]] | None = None
        self._version, self._is_over = 0, False
        self._text, self._text_version = "", 0
        self._due = 0.0

    def update(self, recorder: Recorder) -> None:
        """Offer the state of a recording if that is due. Call this after each step."""
        begin = time.monotonic()
        if begin < self._due:
            return
        self._offer(recorder)
        now = time.monotonic()
        self._due = now + max(LEAST_PAUSE, (now - begin) / SHARE)

    def end(self, recorder: Recorder | None = None) -> None:
        """Offer the last state, and say that no other will come."""
        if recorder is not None:
            self._offer(recorder)
        with self._changed:
            self._is_over = True
            self._changed.notify_all()

    def _offer(self, recorder: Recorder) -> None:
        arrays, meta = recorder.arrays(), recorder.meta()
        with self._changed:
            self._state, self._version = (self._fixed | arrays, {**meta, "check": ""}), self._version + 1
            self._changed.notify_all()

    def wait(self, version: int) -> tuple[int, bool]:
        """Wait for a state after a version; the number of the latest one, and whether the run is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._version > version or self._is_over, _PATIENCE)
            return self._version, self._is_over

    def text(self) -> str:
        """The latest state as the page reads it; empty before the first."""
        with self._changed:
            state, version = self._state, self._version
        if state is not None and version != self._text_version:
            arrays, meta = state
            self._text, self._text_version = packed(arrays, told_to_page(self.title, meta), level=1), version
        return self._text


class Follower:
    """Records a mapper while it runs, from its first step that is noted.

    Parameters
    ----------
    page
        Gets the states of the recording; None where no page shows it.
    steps
        Largest number of steps that will come.
    """

    def __init__(self, page: LivePage | None, steps: int) -> None:
        self._page, self._steps = page, steps
        self._recorder: Recorder | None = None

    def note(
        self, mapper: Mapper, policies: Sequence[Policy], seconds: float, true: FloatArray | None = None
    ) -> Recorder:
        """Note a step, after the policies have decided, with the true poses (n, 3) where they are known.

        Returns
        -------
        Recorder
            The recording so far.
        """
        if self._recorder is None:
            self._recorder = Recorder(mapper, self._steps)
        ranges = np.full((len(mapper.poses), len(mapper.robot.beams)), np.nan)
        for row, front in zip(ranges, mapper.slam.robots, strict=False):  # of robots apart, the SLAM has the first one
            row[:] = np.where(front.measured | front.dropped, front.ranges, np.nan)
        self._recorder.note(seconds, ranges, policies, true)
        if self._page is not None:
            self._page.update(self._recorder)
        return self._recorder

    def end(self) -> None:
        """Show the last state, after the mapper has used its pending readings."""
        if self._recorder is not None:
            self._recorder.finish()
        if self._page is not None:
            self._page.end(self._recorder)


@contextmanager
def live_page(title: str, edges: FloatArray | None = None) -> Iterator[LivePage]:
    """A page that is served on a free port while the context lasts.

    Parameters
    ----------
    title
        What the page shows, in one line.
    edges
        True walls (k, 4), m, where they are known.
    """
    with ThreadingHTTPServer((HOST, 0), _Handler) as server:
        server.daemon_threads = True
        server.page = page = LivePage(title, f"http://{HOST}:{server.server_port}/", edges)  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        thread.start()
        try:
            yield page
        finally:
            page.end()
            time.sleep(LEAST_PAUSE)  # open pages fetch the last state
            server.shutdown()


class _Handler(BaseHTTPRequestHandler):
    """Answers the page: the page itself, the latest state, and the numbers of new states as they come."""

    protocol_version = "HTTP/1.1"

    @property
    def _page(self) -> LivePage:
        page: LivePage = self.server.page  # type: ignore[attr-defined]
        return page

    def do_GET(self) -> None:
        """Answer a request."""
        page = self._page
        if f"http://{self.headers.get('Host', '')}/" != page.address:  # a name of somebody else that leads here
            self.send_error(403)
        elif self.path.split("#")[0] == "/":
            self._send(empty_page(page.title), "text/html; charset=utf-8")
        elif self.path == "/recording":
            self._send(page.text(), "text/plain; charset=ascii")
        elif self.path == "/changes":
            self._tell_changes(page)
        else:
            self.send_error(404)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (the name of the base class)
        """Say nothing on the screen."""

    def _send(self, text: str, kind: str) -> None:
        content = text.encode()
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def _tell_changes(self, page: LivePage) -> None:
        """Send an event for each new state (server-sent events), and one at the end."""
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.end_headers()
        version, is_over = 0, False
        try:
            while not is_over:
                newest, is_over = page.wait(version)
                event = "recording" if newest > version else "nothing"
                self.wfile.write(f"event: {'end' if is_over else event}\ndata: {newest}\n\n".encode())
                self.wfile.flush()
                version = newest
        except OSError:  # the page was closed
            return
        finally:
            self.close_connection = True
