"""Atomic writing of video files: H.264 in .mp4, and .gif. A file is either complete or does not exist."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from PIL import Image as Pictures

from limslam_agent.output.atomic_write import atomic_write, check_target
from limslam_agent.output.style import FREE, PALETTE, Image, mixed

SUFFIXES = (".mp4", ".gif")

# A GIF stores whole pictures. Fewer and smaller pictures with few colours keep the file small.
_GIF_WIDTH, _GIF_FPS, _GIF_COLOURS, _GIF_FRAMES = 960, 8.0, 144, 320


class VideoError(ValueError):
    """A video cannot be written. The message says why."""


@contextmanager
def video_file(path: str | Path, fps: float, size: tuple[int, int], *, force: bool = False) -> "Iterator[VideoWriter]":
    """Write a video file, which appears only when the context ends without an error.

    Parameters
    ----------
    path
        The file, ``.mp4`` or ``.gif``. Missing folders are made.
    fps
        Frames per second. A GIF leaves out frames that would make it too large.
    size
        Width and height of all frames, pixels, both even.
    force
        Whether an existing file may be replaced.

    Raises
    ------
    OutputError
        If the suffix is another one, or something exists at the path.
    VideoError
        If the encoder for .mp4 is missing or fails, or there was no frame.
    OSError
        If the file cannot be written there.
    """
    target = Path(path).absolute()
    check_target(target, "a video", SUFFIXES, force=force)
    with atomic_write(target) as beside:
        writer: VideoWriter = (_Mp4 if target.suffix.lower() == ".mp4" else _Gif)(beside, fps, size)
        try:
            yield writer
            writer.finish()
        finally:
            writer.abandon()


class _Mp4:
    """Sends frames to ffmpeg."""

    def __init__(self, beside: Path, fps: float, size: tuple[int, int]) -> None:
        self._beside, self._fps = beside, fps
        try:
            from imageio_ffmpeg import write_frames

            self._frames = write_frames(
                beside, size, fps=fps, codec="libx264", quality=None, macro_block_size=2, pix_fmt_in="yuv420p",
                ffmpeg_log_level="fatal", output_params=[
                    "-preset", "veryfast", "-crf", "20", "-colorspace", "smpte170m", "-color_primaries", "smpte170m",
                    "-color_trc", "smpte170m", "-movflags", "+faststart",
                ],
            )  # fmt: skip
            self._frames.send(None)
        except (ImportError, RuntimeError) as error:
            raise VideoError("an .mp4 needs an encoder: pip install 'limslam[video]'") from error

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Add a frame (height, width, 3), RGB, that is shown for ``hold`` s, and at least for the time of one frame."""
        # This format has half as many bytes as RGB, and a held frame is converted only once.
        pixels = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).data
        try:
            for _ in range(max(round(hold * self._fps), 1)):
                self._frames.send(pixels)
        except OSError as error:
            raise VideoError("the video cannot be written: ffmpeg has ended") from error

    def finish(self) -> None:
        """Complete the file."""
        self._frames.close()
        if not self._beside.stat().st_size:
            raise VideoError("the video cannot be written: ffmpeg has written nothing")

    def abandon(self) -> None:
        """End ffmpeg, if it has not ended."""
        self._frames.close()


class _Gif:
    """Keeps frames of few colours in memory, each with its time, s, and writes them at the end."""

    def __init__(self, beside: Path, fps: float, size: tuple[int, int]) -> None:
        self._beside, self._frame_time, self._step = beside, 1.0 / fps, 1.0 / _GIF_FPS
        self._size = size if size[0] <= _GIF_WIDTH else (_GIF_WIDTH, round(size[1] * _GIF_WIDTH / size[0]))
        self._frames: list[tuple[float, Pictures.Image]] = []
        self._palette: Pictures.Image | None = None
        self._time = 0.0

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Take a frame (height, width, 3), RGB, that is shown for ``hold`` s, unless it comes too soon to be seen."""
        begin, lasts = self._time, max(hold, self._frame_time)
        self._time += lasts
        if self._frames and begin - self._frames[-1][0] < self._step - 1e-9 and lasts < self._step:
            return
        small = Pictures.fromarray(np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)))
        self._palette = self._palette or _palette(small)
        self._frames.append((begin, small.quantize(palette=self._palette, dither=Pictures.Dither.NONE)))
        if len(self._frames) > _GIF_FRAMES:
            self._frames, self._step = self._frames[::2], 2.0 * self._step

    def finish(self) -> None:
        """Complete the file."""
        if not self._frames:
            raise VideoError("the video cannot be written: there are no frames")
        times = np.diff([*(begin for begin, _ in self._frames), self._time])
        first, *others = (picture for _, picture in self._frames)
        # The unit of time in a GIF is 1/100 s.
        durations = [10 * round(100.0 * time) for time in times.tolist()]
        first.save(
            self._beside, format="GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=False
        )

    def abandon(self) -> None:
        """Free the memory."""
        self._frames = []


def _palette(picture: Pictures.Image) -> Pictures.Image:
    """One palette for all frames, so that regions without change need no space in the file.

    It has the colours of a picture, and those of thin lines and rings, also where they are pale.
    """
    fixed = [*PALETTE, *(mixed(colour, FREE, 0.5) for colour in PALETTE)]
    found = picture.quantize(_GIF_COLOURS - len(fixed), method=Pictures.Quantize.MEDIANCUT).getpalette() or []
    palette = Pictures.new("P", (1, 1))
    palette.putpalette([*(part for colour in fixed for part in colour), *found])
    return palette


VideoWriter: TypeAlias = _Mp4 | _Gif
"""Takes the frames of a video file, which :func:`video_file` makes."""
