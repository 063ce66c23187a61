# ruff: noqa: INP001
"""Makes ``film.webp`` and ``film.png`` from videos of runs (extra ``video``).

``limslam run --world env2 --noise 0.02 --video run.mp4 && python docs/images/film.py run.mp4``
"""

import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image

FRAMES, SECONDS = 90, 12.0
WIDTH = 960
LAST = 75  # frames of a video that show its end
STILL = 0.55  # share of the video after which ``film.png`` is taken
ROWS = slice(118, 556)  # of a frame of Env2, which show the two pictures


def main(video: Path) -> None:
    """Write both files beside this one."""
    reader = imageio_ffmpeg.read_frames(str(video))
    width, height = next(reader)["size"]
    frames = [np.frombuffer(frame, dtype=np.uint8).reshape(height, width, 3) for frame in reader][:-LAST]
    here = Path(__file__)
    Image.fromarray(frames[int(STILL * len(frames))]).save(here.with_suffix(".png"), optimize=True)
    kept = [frames[index][ROWS] for index in np.linspace(0, len(frames) - 1, FRAMES).astype(int)]
    size = WIDTH, kept[0].shape[0] * WIDTH // width
    first, *others = (Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in kept)
    each = int(1000 * SECONDS / FRAMES)
    durations = [each] * len(others) + [2000]  # the finished map stays for a moment
    first.save(
        here.with_suffix(".webp"), save_all=True, append_images=others, duration=durations, loop=0, quality=70, method=6
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
