"""Atomic writing of video files: H.264 in .mp4, and .gif. A file is either complete or does not
exist.
"""

import importlib
import subprocess
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TypeAlias

import cv2
import numpy as np
from PIL import Image as Pictures

from limslam_agent.output.atomic_write import atomic_write, check_target
from limslam_agent.output.style import PALETTE
from limslam_env.canvas import Image

SUFFIXES = (".mp4", ".gif")

# A GIF stores whole pictures. Fewer and smaller pictures with few colours keep the file small.
_GIF_WIDTH = 960
_GIF_FPS = 8.0
_GIF_COLOURS = 144
_GIF_FRAMES = 320
_GIF_PALETTE_SAMPLES = 12


class VideoError(ValueError):
    """A video cannot be written. The message says which and why."""


@contextmanager
def video_file(
    path: str | Path, fps: float, size: tuple[int, int], *, force: bool = False
) -> "Iterator[VideoWriter]":
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
    program = _ffmpeg() if target.suffix.lower() == ".mp4" else None
    with atomic_write(target) as beside:
        writer: VideoWriter = (
            _Mp4(target, fps, beside, program, size) if program else _Gif(target, fps, beside)
        )
        try:
            yield writer
            writer.finish()
        finally:
            writer.abandon()


class _Mp4:
    """Sends frames to ffmpeg through a pipe."""

    def __init__(
        self, path: Path, fps: float, beside: Path, program: str, size: tuple[int, int]
    ) -> None:
        self._path = path
        self._fps = fps
        # Error messages go to a file, because a pipe without a reader would fill up and block.
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed when abandoned)
        options = (
            f"-y -loglevel error -f rawvideo -pix_fmt yuv420p -s {size[0]}x{size[1]} -r {fps:g} "
            "-i - -an -c:v libx264 -preset veryfast -crf 20 -colorspace smpte170m "
            "-color_primaries smpte170m -color_trc smpte170m -pix_fmt yuv420p -movflags +faststart"
        )
        # A separate session keeps a keyboard interrupt away from ffmpeg. This class ends ffmpeg.
        self._process = subprocess.Popen(  # noqa: S603 (the program is imageio-ffmpeg's)
            [program, *options.split(), str(beside)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
        )

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Add a frame (height, width, 3), RGB, that is shown for ``hold`` s, and at least for the
        time of one frame.
        """
        # This format has half as many bytes as RGB, and a held frame is converted only once.
        pixels = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).data
        try:
            for _ in range(max(round(hold * self._fps), 1)):
                _pipe(self._process).write(pixels)
        except OSError as error:
            raise VideoError(
                f"{self._path}: cannot be written: {self._last_error() or error}"
            ) from error

    def finish(self) -> None:
        """Complete the file."""
        _pipe(self._process).close()
        if self._process.wait():
            raise VideoError(
                f"{self._path}: cannot be written: {self._last_error() or 'ffmpeg failed'}"
            )

    def abandon(self) -> None:
        """Free all resources."""
        if self._process.poll() is None:
            self._process.kill()
        # Data that is still in the pipe is not needed.
        with suppress(OSError):
            _pipe(self._process).close()
        self._process.wait()
        self._errors.close()

    def _last_error(self) -> str:
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""


class _Gif:
    """Keeps compressed frames in memory, and writes them at the end, when all colours are known."""

    def __init__(self, path: Path, fps: float, beside: Path) -> None:
        self._path = path
        self._beside = beside
        self._frame_time = 1.0 / fps
        self._step = max(1.0 / _GIF_FPS, self._frame_time)
        self._frames: list[tuple[bytes, float]] = []
        self._size = (0, 0)
        self._owed = 0.0

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Take a frame (height, width, 3), RGB, unless the last has to be shown longer. The speed
        of the video stays the same.
        """
        time = max(hold, self._frame_time)
        if self._frames and self._owed + time < self._step - 1e-9:
            self._owed += time
            return
        height, width = image.shape[:2]
        small = image
        self._size = (width, height)
        if width > _GIF_WIDTH:
            self._size = (_GIF_WIDTH, round(height * _GIF_WIDTH / width))
            resized = cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)
            small = np.asarray(resized, dtype=np.uint8)
        if self._frames:
            last, shown = self._frames[-1]
            self._frames[-1] = (last, shown + self._owed)
        self._owed = 0.0
        self._frames.append((zlib.compress(small.tobytes(), 1), time))
        if len(self._frames) > _GIF_FRAMES:
            self._thin()

    def _thin(self) -> None:
        """Remove every second frame that was not held, and show the frame before it longer."""
        kept: list[tuple[bytes, float]] = []
        is_odd = False
        for data, time in self._frames:
            is_odd = not is_odd
            if is_odd or time > 1.5 * self._step or not kept:
                kept.append((data, time))
            else:
                kept[-1] = (kept[-1][0], kept[-1][1] + time)
        self._frames = kept
        self._step *= 2.0

    def finish(self) -> None:
        """Complete the file."""
        if not self._frames:
            raise VideoError(f"{self._path}: there are no frames")
        palette = self._palette()
        frames = (
            frame.quantize(palette=palette, dither=Pictures.Dither.NONE)
            for frame in self._pictures()
        )
        # The unit of time in a GIF is 1/100 s.
        times = [10 * round(100.0 * time) for _, time in self._frames]
        next(frames).save(
            self._beside,
            format="GIF",
            save_all=True,
            append_images=frames,
            duration=times,
            loop=0,
            optimize=False,
        )

    def abandon(self) -> None:
        """Free all resources."""
        self._frames = []

    def _pictures(self, every: int = 1) -> Iterator[Pictures.Image]:
        for data, _ in self._frames[::every]:
            yield Pictures.frombytes("RGB", self._size, zlib.decompress(data))

    def _palette(self) -> Pictures.Image:
        """One palette for all frames, so that regions without change need no space in the file."""
        every = max(len(self._frames) // _GIF_PALETTE_SAMPLES, 1)
        width, height = self._size
        sheet = Pictures.new("RGB", (width, height * len(self._frames[::every])))
        for number, picture in enumerate(self._pictures(every)):
            sheet.paste(picture, (0, number * height))
        colours = _GIF_COLOURS - len(PALETTE)
        found = sheet.quantize(colours, method=Pictures.Quantize.MEDIANCUT).getpalette() or []
        # Thin lines and rings have few pixels. Without fixed colours they would lose their colours.
        palette = Pictures.new("P", (1, 1))
        palette.putpalette([*(part for colour in PALETTE for part in colour), *found])
        return palette


VideoWriter: TypeAlias = _Mp4 | _Gif
"""Takes the frames of a video file, which :func:`video_file` makes."""


def _ffmpeg() -> str:
    """The path of an ffmpeg that supports H.264."""
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise VideoError('an .mp4 needs an encoder: pip install "limslam[video]"') from error


def _pipe(process: "subprocess.Popen[bytes]") -> IO[bytes]:
    if process.stdin is None:
        raise VideoError("ffmpeg takes no frames")
    return process.stdin
