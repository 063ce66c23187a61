"""What tests of the environments share."""

import pytest


@pytest.fixture
def pygame(monkeypatch):
    """Pygame with a display that nobody sees."""
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    pygame.display.quit()
    yield pygame
    pygame.display.quit()
