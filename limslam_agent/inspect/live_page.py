"""Shows a recording in a browser while it grows: a server for this computer alone."""

import hmac
import json
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.inspect.columns import packed
from limslam_agent.inspect.page import content_of
from limslam_agent.inspect.page import page as page_of
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

_OWN_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]+)?", re.IGNORECASE)
"""Names by which a browser on this computer calls the server, with the port of a tunnel or none.

Any other name could be a stranger's that was made to lead here, and the stranger's page could then
read this one.
"""

_NUMBER = re.compile(r"[0-9]{0,18}")
"""The number of a state in a request; empty for none."""

_LONGEST_ORDER = 1000
"""Most bytes of an order."""

_PATIENCE = 1.0
"""Seconds after which a page that waits for a new state is told that there is none."""


@dataclass(frozen=True)
class Controls:
    """How a page gives orders to a robot."""

    # Carries out an order of the page, in another thread. Raises a ValueError for what is none.
    obey: Callable[[Mapping[str, Any]], None]
    state: Callable[[], Mapping[str, Any]]  # What the page shows of the orders


class LivePage:
    """The latest state of a recording, for any number of pages that show it.

    Attributes
    ----------
    address
        Where the page is.
    is_over
        Whether no other state will come.
    controls
        How the page gives orders, if it may give any. Only pages whose address has ``token`` may.
    """

    def __init__(
        self,
        title: str,
        address: str,
        edges: FloatArray | None = None,
        controls: Controls | None = None,
    ) -> None:
        self.title = title
        self.controls = controls
        self.token = secrets.token_urlsafe(16)
        self.address = address if controls is None else f"{address}?token={self.token}"
        self.is_over = False
        self._fixed = {} if edges is None else {"edges": edges.astype(np.float32)}
        self._changed = threading.Condition()
        # Each is replaced as a whole, so that the run does not wait while a state is packed for a
        # page.
        self._state: tuple[int, dict[str, NDArray[Any]], dict[str, Any]] = 0, {}, {}
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
            self.is_over = True
            self._changed.notify_all()

    def _offer(self, recorder: Recorder) -> None:
        state = (
            self._state[0] + 1,
            self._fixed | recorder.arrays(),
            {**recorder.meta(), "check": ""},
        )
        with self._changed:
            self._state = state
            self._changed.notify_all()

    def newest(self, version: int) -> tuple[int, str]:
        """The number of the latest state, and the state as the page reads it; empty if its number
        is ``version``.

        A page that has the latest one waits here for the next, because browsers slow the clocks of
        hidden pages.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._state[0] not in {0, version} or self.is_over, _PATIENCE
            )
            number, arrays, meta = self._state
        is_new = number not in {0, version}
        return number, packed(arrays, content_of(self.title, meta), level=1) if is_new else ""


class Follower:
    """Records a mapper while it runs, from its first step that is noted, for a page if there is
    one.

    ``steps`` is the largest number of steps that will come.
    """

    def __init__(self, page: LivePage | None, steps: int) -> None:
        self._page = page
        self._steps = steps
        self._recorder: Recorder | None = None

    def note(
        self,
        mapper: Mapper,
        policies: Sequence[Policy],
        seconds: float,
        true: FloatArray | None = None,
    ) -> Recorder:
        """Note a step, after the policies have decided, with the true poses (n, 3) where they are
        known. Returns the recording so far.
        """
        if self._recorder is None:
            self._recorder = Recorder(mapper, self._steps)
        ranges = np.full((len(mapper.poses), len(mapper.robot.beams)), np.nan)
        for row, front in zip(
            ranges, mapper.slam.robots, strict=False
        ):  # of robots apart, the SLAM has the first one
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
def live_page(
    title: str, edges: FloatArray | None = None, controls: Controls | None = None
) -> Iterator[LivePage]:
    """A page that is served on a free port while the context lasts, with the true walls (k, 4), m,
    if known, and the means to give orders if there are any.
    """
    with _Server((HOST, 0), _Handler) as server:
        address = f"http://{HOST}:{server.server_port}/"
        server.page = page = LivePage(title, address, edges, controls)
        thread = threading.Thread(
            target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True
        )
        thread.start()
        try:
            yield page
        finally:
            page.end()
            time.sleep(LEAST_PAUSE)  # open pages fetch the last state
            server.shutdown()


class _Server(ThreadingHTTPServer):
    """Serves one page in threads that do not outlive the program."""

    daemon_threads = True
    page: LivePage

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a connection that the browser has closed; report what else failed."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers the page: the page itself, and ``/recording?N``, the latest state unless its number
    is N. ``/order`` takes the orders of a page that knows the token.
    """

    server: _Server

    def do_GET(self) -> None:
        """Answer a request."""
        page = self.server.page
        path, _, known = self.path.partition("?")
        if not _OWN_HOST.fullmatch(self.headers.get("Host", "")):
            self.send_error(403)
        elif path == "/":
            self._send(page_of(page.title), "text/html; charset=utf-8")
        elif path == "/recording" and not _NUMBER.fullmatch(known):
            self.send_error(400)
        elif path == "/recording":
            # Asked before the state: what comes after the last one is nothing.
            is_over = page.is_over
            version, text = page.newest(int(known or 0))
            orders = None if page.controls is None else page.controls.state()
            self._send(
                text,
                "text/plain; charset=ascii",
                {
                    "X-State": str(version),
                    "X-Over": str(int(is_over)),
                    "X-Orders": json.dumps(orders),
                },
            )
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        """Take an order."""
        page = self.server.page
        token = self.headers.get("X-Token", "")
        size = self.headers.get("Content-Length", "")
        is_known = hmac.compare_digest(token.encode(), page.token.encode())
        if not _OWN_HOST.fullmatch(self.headers.get("Host", "")) or not is_known:
            self.send_error(403)
        elif page.controls is None or self.path != "/order":
            self.send_error(404)
        elif not _NUMBER.fullmatch(size) or not 0 < int(size or 0) <= _LONGEST_ORDER:
            self.send_error(400)
        else:
            try:
                order = json.loads(self.rfile.read(int(size)))
                page.controls.obey(order if isinstance(order, dict) else {})
            except (ValueError, RecursionError):  # no JSON, or no order
                self.send_error(400)
            else:
                self._send("", "text/plain; charset=ascii")

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (the name of the base class)
        """Say nothing on the screen."""

    def _send(
        self, text: str, kind: str, headers: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        content = text.encode()
        self.send_response(200)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            **headers,
        }.items():
            self.send_header(name, value)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)
