"""The window of the ``human`` render mode, on pygame (extra ``play``), which is loaded when the
window opens.
"""

import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled, Error
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pygame


class Window:
    """A window that shows pictures and knows which keys are held. It opens with the first picture.

    One process has one window: where several are open, the last one to show a picture has it.

    It has a ``title``, and shows at most ``fps`` pictures a second: :meth:`show` waits until the
    next one is due. The attribute ``closed`` says whether the window has been closed, by its user
    or by :meth:`close`.

    Raises
    ------
    DependencyNotInstalled
        If pygame is missing.
    """

    def __init__(self, title: str, fps: float) -> None:
        self.title = title
        self.fps = fps
        self._pygame = _load_pygame()
        self._clock = self._pygame.time.Clock()
        self._screen: pygame.Surface | None = None
        self.closed = False
        self._held: set[str] = set()
        self._pressed: set[str] = set()

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show a picture (height, width, 3), RGB, when it is due. A closed window stays closed.

        Raises
        ------
        gymnasium.error.Error
            If there is no display to open a window on.
        """
        if self.closed:
            return
        pygame = self._pygame
        size = (image.shape[1], image.shape[0])
        if (
            self._screen is None
            or pygame.display.get_surface() is not self._screen
            or self._screen.get_size() != size
        ):
            self._open(size)
        if self._screen is not None:
            self._screen.blit(
                pygame.image.frombuffer(np.ascontiguousarray(image).tobytes(), size, "RGB"), (0, 0)
            )
            pygame.display.flip()
        self._listen()
        self._clock.tick(self.fps)

    def pressed_keys(self) -> frozenset[str]:
        """Names of the keys that are held, or were pressed since the last call ("left", "w",
        "space", ...).
        """
        self._listen()
        keys = frozenset(self._held | self._pressed)
        self._pressed.clear()
        return keys

    def close(self) -> None:
        """Close the window; closing it again does nothing."""
        if self._screen is not None and self._pygame.display.get_surface() is self._screen:
            self._pygame.display.quit()
        self._screen = None
        self.closed = True
        self._held.clear()

    def _open(self, size: tuple[int, int]) -> None:
        pygame = self._pygame
        # SDL would look for a display, and complain on the terminal that there is none.
        hidden = {} if has_display() else {"SDL_VIDEODRIVER": "dummy"}
        os.environ.update(hidden)
        try:
            pygame.display.init()
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise Error(f"no window can be opened: {error}") from error
        finally:
            for name in hidden:
                del os.environ[name]
        pygame.display.set_caption(self.title)

    def _listen(self) -> None:
        """Take in what has happened since the last look. Without this, the system calls the window
        unresponsive.
        """
        pygame = self._pygame
        if self._screen is None or not pygame.display.get_init():
            return
        for event in pygame.event.get():
            if event.type == pygame.KEYDOWN:
                name = pygame.key.name(event.key)
                self._held.add(name)
                self._pressed.add(name)
            elif event.type == pygame.KEYUP:
                self._held.discard(pygame.key.name(event.key))
            elif event.type == pygame.WINDOWFOCUSLOST:
                # Keys that are let go while another window has the keyboard are not reported.
                self._held.clear()
            elif event.type == pygame.QUIT:
                self.close()
                return


def _load_pygame() -> Any:
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(
            'a window needs pygame: pip install "limslam[play]"'
        ) from error
    return pygame


def has_display() -> bool:
    """Whether there is a display to open a window on. Without a display, pictures are drawn and not
    shown.
    """
    wanted = ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in wanted)
