# ruff: noqa: INP001
"""Makes ``film.webp`` from the video of a run: ``python docs/images/film.py run.mp4`` (extra
``video``).
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from imageio_ffmpeg import read_frames
from PIL import Image

FRAMES, SECONDS = 90, 12.0
TOP = 402  # rows of a frame that show the two pictures, without the panels below them
WIDTH = 960
SPEED = (
    slice(14, 42),
    slice(930, 1005),
)  # where a frame shows the speed of the video, which this film does not have
CHANGE = 60  # difference of a colour by which a digit differs, and not the compression of the video
CLOCK = (
    slice(10, 42),
    slice(1180, 1280),
)  # where a frame shows the time, which stands still while the video is paused


def frames_of(video: Path) -> list[Image.Image]:
    """Frames of the run, evenly spread, without the stretches in which the video is paused."""
    decoded = read_frames(str(video))
    width, height = next(decoded)["size"]
    frames = [
        np.frombuffer(each, dtype=np.uint8).reshape(height, width, 3)[:TOP] for each in decoded
    ]
    moving = [
        frame
        for last, frame in pairwise(frames)
        if np.abs(frame[CLOCK].astype(int) - last[CLOCK]).max() > CHANGE
    ] + frames[-1:]
    kept = [moving[index].copy() for index in np.linspace(0, len(moving) - 1, FRAMES).astype(int)]
    for frame in kept:
        frame[SPEED] = frame[0, 0]
    return [
        Image.fromarray(frame).resize(
            (WIDTH, TOP * WIDTH // frame.shape[1]), Image.Resampling.LANCZOS
        )
        for frame in kept
    ]


def main(video: Path) -> None:
    """Write ``film.webp`` beside this file."""
    first, *others = frames_of(video)
    each = int(1000 * SECONDS / FRAMES)
    durations = [each] * len(others) + [2000]  # the finished map stays for a moment
    first.save(
        Path(__file__).with_suffix(".webp"),
        save_all=True,
        append_images=others,
        duration=durations,
        loop=0,
        quality=70,
        method=6,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
