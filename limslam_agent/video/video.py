"""Video files that are whole or not there at all: H.264 in .mp4, which plays everywhere, and .gif."""

import importlib
import subprocess
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Protocol, Self

import cv2
import numpy as np
from PIL import Image as Pictures

from limslam_agent.output.atomic_write import whole_file
from limslam_agent.output.style import PALETTE, Image

SUFFIXES = (".mp4", ".gif")

_FASTEST_FPS = 60.0
# A GIF holds each picture whole: fewer, smaller ones with few colours keep it small enough to be sent by mail.
_GIF_WIDTH, _GIF_FPS, _GIF_COLOURS = 960, 8.0, 144
_GIF_FRAMES = 320
_GIF_PALETTE_SAMPLES = 12


class VideoError(ValueError):
    """A video that cannot be written. The message says which and why."""


class _Encoder(Protocol):
    """What makes a file of frames. ``abandon`` frees all it holds, and comes last, whether it was finished or not."""

    def add(self, image: Image, hold: float) -> None: ...

    def finish(self) -> None: ...

    def abandon(self) -> None: ...


class VideoWriter:
    """Writes a video file; a context manager. The file appears when the context ends well, and only then.

    Parameters
    ----------
    path
        What to write, ``.mp4`` or ``.gif``. Folders that are missing are made when it is done.
    fps
        Frames per second. A GIF leaves frames out that would make it too large.
    force
        Whether a file that is there may be replaced.

    Raises
    ------
    VideoError
        If the suffix is another one, something is there already, or what encodes .mp4 is missing: all of it before
        there is a frame. When the context ends, if there is none.
    OSError
        On entering the context, if the place cannot be written to.
    """

    def __init__(self, path: str | Path, fps: float, *, force: bool = False) -> None:
        self.path, self.fps = Path(path).absolute(), float(fps)
        self._suffix = self.path.suffix.lower()
        if self._suffix not in SUFFIXES:
            raise VideoError(f"{path}: a video ends in {' or '.join(SUFFIXES)}")
        if not 0.0 < self.fps <= _FASTEST_FPS:
            raise VideoError(f"{path}: a video has up to {_FASTEST_FPS:g} frames per second, not {fps:g}")
        if self.path.is_dir():
            raise VideoError(f"{path}: is a folder")
        if self.path.exists() and not force:
            raise VideoError(f"{path}: is there already; --force replaces it")
        self._program = _ffmpeg() if self._suffix == ".mp4" else ""
        self._beside: Path | None = None
        self._encoder: _Encoder | None = None

    def __enter__(self) -> Self:
        self._session = self._recording()
        self._session.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.__exit__(kind, error, trace)

    @contextmanager
    def _recording(self) -> Iterator[None]:
        with whole_file(self.path) as beside:
            self._beside = beside
            try:
                yield
                if self._encoder is None:
                    raise VideoError(f"{self.path}: there is not a single frame")
                self._encoder.finish()
            finally:
                encoder, self._encoder, self._beside = self._encoder, None, None
                if encoder is not None:
                    encoder.abandon()

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Add a frame.

        Parameters
        ----------
        image
            (height, width, 3), RGB; all of one size with even sides.
        hold
            How long it is shown, s; as long as any frame if that is more.

        Raises
        ------
        VideoError
            If a frame is none, has another size than the first, or nobody takes it any more.
        """
        if self._beside is None:
            raise VideoError(f"{self.path}: frames are written within the writer's context")
        if image.dtype != np.uint8 or image.shape[2:] != (3,) or image.shape[0] % 2 or image.shape[1] % 2:
            raise VideoError(f"{self.path}: a frame is (height, width, 3) in bytes, even sides, not {image.shape}")
        if self._encoder is None:
            self._shape = image.shape
            self._encoder = (
                _Mp4(self._beside, self._program, self.path, image, self.fps)
                if self._program
                else _Gif(self._beside, self.fps)
            )
        if image.shape != self._shape:
            raise VideoError(f"{self.path}: a frame of {image.shape} has another size than the first, {self._shape}")
        self._encoder.add(image, hold)


class _Mp4:
    """Frames through a pipe to ffmpeg."""

    def __init__(self, beside: Path, program: str, path: Path, image: Image, fps: float) -> None:
        self._path, self._fps = path, fps
        # Its complaints go to a file: a pipe that nobody reads fills up, and then everything waits.
        self._complaints: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed when abandoned)
        height, width = image.shape[:2]
        command = [
            program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "yuv420p", "-s", f"{width}x{height}",
            "-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264", "-preset", "veryfast", "-crf", "20",
            "-colorspace", "smpte170m", "-color_primaries", "smpte170m", "-color_trc", "smpte170m",
            "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(beside),
        ]  # fmt: skip
        # A session of its own: an interrupt at the keyboard is for us, and ffmpeg ends when we say so.
        self._process = subprocess.Popen(  # noqa: S603 (the program is imageio-ffmpeg's)
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._complaints, start_new_session=True
        )

    def add(self, image: Image, hold: float) -> None:
        # Half as many bytes as RGB, and converted once however long the frame is held.
        pixels = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420).data
        try:
            for _ in range(max(round(hold * self._fps), 1)):
                _pipe(self._process).write(pixels)
        except OSError as error:
            raise VideoError(f"{self._path}: cannot be written: {self._complaint() or error}") from error

    def finish(self) -> None:
        _pipe(self._process).close()
        if self._process.wait():
            raise VideoError(f"{self._path}: cannot be written: {self._complaint() or 'ffmpeg failed'}")

    def abandon(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
        # What is still in the pipe is of no use.
        with suppress(OSError):
            _pipe(self._process).close()
        self._process.wait()
        self._complaints.close()

    def _complaint(self) -> str:
        self._process.wait()
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""


class _Gif:
    """Frames kept small in memory, and written at the end, when it is known which colours they need."""

    def __init__(self, path: Path, fps: float) -> None:
        self._path, self._frame_time = path, 1.0 / fps
        self._step = max(1.0 / _GIF_FPS, self._frame_time)
        self._frames: list[tuple[bytes, float]] = []
        self._size = (0, 0)
        self._owed = 0.0

    def add(self, image: Image, hold: float) -> None:
        """Take a frame unless the last one is still to be shown: time is handed on, so the speed stays."""
        time = max(hold, self._frame_time)
        if self._frames and self._owed + time < self._step - 1e-9:
            self._owed += time
            return
        small = _small(image)
        self._size = (small.shape[1], small.shape[0])
        if self._frames:
            last, shown = self._frames[-1]
            self._frames[-1] = (last, shown + self._owed)
        self._owed = 0.0
        self._frames.append((zlib.compress(small.tobytes(), 1), time))
        if len(self._frames) > _GIF_FRAMES:
            self._thin()

    def _thin(self) -> None:
        """Leave out every second frame that was not held, and show the one before it longer."""
        kept: list[tuple[bytes, float]] = []
        is_odd = False
        for data, time in self._frames:
            is_odd = not is_odd
            if is_odd or time > 1.5 * self._step or not kept:
                kept.append((data, time))
            else:
                kept[-1] = (kept[-1][0], kept[-1][1] + time)
        self._frames, self._step = kept, 2.0 * self._step

    def finish(self) -> None:
        palette = self._palette()
        frames = (frame.quantize(palette=palette, dither=Pictures.Dither.NONE) for frame in self._pictures())
        # GIF counts in hundredths of a second.
        times = [10 * round(100.0 * time) for _, time in self._frames]
        next(frames).save(
            self._path, format="GIF", save_all=True, append_images=frames, duration=times, loop=0, optimize=False
        )

    def abandon(self) -> None:
        self._frames = []

    def _pictures(self) -> Iterator[Pictures.Image]:
        for data, _ in self._frames:
            yield Pictures.frombytes("RGB", self._size, zlib.decompress(data))

    def _palette(self) -> Pictures.Image:
        """Colours for all frames alike, so that what stands still stays the same and costs nothing."""
        every = max(len(self._frames) // _GIF_PALETTE_SAMPLES, 1)
        width, height = self._size
        samples = self._frames[::every]
        sheet = Pictures.new("RGB", (width, height * len(samples)))
        for number, (data, _) in enumerate(samples):
            sheet.paste(Pictures.frombytes("RGB", self._size, zlib.decompress(data)), (0, number * height))
        found = sheet.quantize(_GIF_COLOURS - len(PALETTE), method=Pictures.Quantize.MEDIANCUT).getpalette() or []
        # Thin lines and rings are few pixels, and would lose their colours to the many.
        palette = Pictures.new("P", (1, 1))
        palette.putpalette([*(part for colour in PALETTE for part in colour), *found])
        return palette


def _small(image: Image) -> Image:
    height, width = image.shape[:2]
    if width <= _GIF_WIDTH:
        return image
    size = (_GIF_WIDTH, round(height * _GIF_WIDTH / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _ffmpeg() -> str:
    """The path of an ffmpeg that knows H.264."""
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise VideoError("an .mp4 needs an encoder: pip install 'limslam[video]'") from error


def _pipe(process: "subprocess.Popen[bytes]") -> IO[bytes]:
    if process.stdin is None:
        raise VideoError("ffmpeg takes no frames")
    return process.stdin
