"""Opens ROS 1 and ROS 2 bags with rosbags, and turns every error of rosbags into an error of one
line.

rosbags is an extra (``pip install "limslam[ros]"``). It is imported when the first bag is opened.
ROS is not needed.
"""

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from limslam_agent.logs.recorded_log import FilePath, LogError, first_bytes, naming

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

METADATA = "metadata.yaml"

# First bytes of the files, and the suffix by which rosbags recognises them.
_MAGIC = {b"#ROSBAG V": ".bag", b"\x89MCAP": ".mcap", b"SQLite format 3": ".db3"}
_LONGEST_MAGIC = max(map(len, _MAGIC))
_LONGEST_REASON = 200
# What mends a bag whose recorder did not end, by the suffix of the file
_REMEDIES = {
    ".bag": "rosbag reindex",
    ".mcap": "mcap recover",
    ".db3": "sqlite3 with .recover, and then ros2 bag reindex,",
}


class Message(NamedTuple):
    """One message: its topic, the time when the bag received it (s), and its content."""

    topic: str
    bag_time: float
    content: Any


def is_bag(path: FilePath) -> bool:
    """Whether a path can only be a bag, by a file's first bytes or suffix. Of all logs, only ROS 2
    bags are folders. Raises a LogError if the file cannot be read.
    """
    place = Path(path)
    return place.is_dir() or place.suffix in _MAGIC.values() or _ending_by_content(path) is not None


class Bag:
    """An open bag.

    Attributes
    ----------
    types
        Type of each topic in the notation of ROS 2: ``sensor_msgs/msg/LaserScan``.
    counts
        Number of messages of each topic.
    """

    def __init__(self, path: FilePath, reader: "AnyReader") -> None:
        self.path = path
        self._reader = reader
        self.types: dict[str, str] = {}
        self.counts = Counter[str]()
        for connection in reader.connections:
            if not isinstance(connection.topic, str) or not isinstance(connection.msgcount, int):
                raise LogError(
                    f"{fspath(path)}: damaged: its list of topics is not one of names and counts"
                )
            self.types[connection.topic] = connection.msgtype
            self.counts[connection.topic] += connection.msgcount

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """The messages of some topics in the order in which the bag received them. Raises a
        LogError if the bag is cut short or damaged.
        """
        connections = [each for each in self._reader.connections if each.topic in topics]
        # Without connections, rosbags reads all of them.
        stream = self._reader.messages(connections) if connections else iter(())
        while True:
            with _one_line(self.path):
                item = next(stream, None)
                if item is None:
                    return
                connection, nanoseconds, raw = item
                content = self._reader.deserialize(raw, connection.msgtype)
            yield Message(connection.topic, 1e-9 * nanoseconds, content)

    def first(self, topic: str) -> Any:
        """First message of a topic. None if the topic has no messages."""
        message = next(self.messages([topic]), None)
        return None if message is None else message.content


@contextmanager
def open_bag(path: FilePath) -> Iterator[Bag]:
    """Open a ROS 1 bag, a ROS 2 bag (a folder), or a single ``.mcap`` or ``.db3`` file. Raises a
    LogError if it is another kind of file, is cut short or damaged, has a suffix that does not
    match its content, or rosbags is missing.
    """
    with naming(path):
        _check_ending(Path(path))
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise ValueError(
                f'bags are read with rosbags: pip install "limslam[ros]" ({error})'
            ) from error
    with _one_line(path):
        # Older ROS 2 bags do not hold the definitions of their types. The standard types have not
        # changed since.
        reader = AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    try:
        with _one_line(path):
            bag = Bag(path, reader)
        yield bag
    finally:
        with _one_line(path):
            reader.close()


def _check_ending(path: Path) -> None:
    if path.is_dir():
        if not (path / METADATA).is_file():
            hint = ""
            if (path / "log.npz").is_file():
                hint = f"; the log of this run is {path / 'log.npz'}"
            elif _storage_suffix(path) is not None:
                hint = "; ros2 bag reindex writes it"
            raise ValueError(f"is a folder, but not a ROS 2 bag: it has no {METADATA}{hint}")
        for file in path.iterdir():
            if not file.is_dir():
                first_bytes(file, 0)  # a pipe in the folder would never end
        return
    ending = _ending_by_content(path)
    if ending is None:
        raise ValueError(f"is not a bag: its first bytes are not those of {', '.join(_REMEDIES)}")
    if path.suffix != ending:
        raise ValueError(f"has the content of a {ending} file, so its name must end in {ending}")


def _ending_by_content(path: FilePath) -> str | None:
    begin = first_bytes(path, _LONGEST_MAGIC)
    return next((ending for magic, ending in _MAGIC.items() if begin.startswith(magic)), None)


@contextmanager
def _one_line(path: FilePath) -> Iterator[None]:
    """Turn any error of rosbags into a LogError. A damaged file can cause errors of any type."""
    with naming(path):
        try:
            yield
        except (LogError, OSError):
            raise
        except Exception as error:  # of rosbags, struct, sqlite or a compressor, and assertions
            its_own = type(error).__module__.startswith("rosbags") and str(error)
            reason = str(error) if its_own else f"{type(error).__name__} {error}"
            what = "cut short, damaged, or of a kind that rosbags cannot read"
            suffix = _storage_suffix(path)
            remedy = f"; {_REMEDIES[suffix]} may mend it" if suffix else ""
            raise ValueError(f"{what}: {reason[:_LONGEST_REASON].strip()}{remedy}") from error


def _storage_suffix(path: FilePath) -> str | None:
    """The suffix of a bag's file, also of one in a folder. None if there is no such file."""
    place = Path(path)
    files = sorted(place.iterdir()) if place.is_dir() else [place]
    return next((file.suffix for file in files if file.suffix in _REMEDIES), None)
