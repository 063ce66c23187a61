"""Maps of map_server with PNG pictures: the same world as with a PGM picture, and one line for every fault."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from limslam_env import load_world
from limslam_env.worlds.formats.pictures import read_levels

ABOUT = "image: {}\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: {}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def levels():
    """A room with a pillar; unknown cells around it."""
    cells = np.full((60, 80), 205, dtype=np.uint8)
    cells[5:55, 5:75] = 0
    cells[7:53, 7:73] = 254
    cells[20:25, 30:36] = 0
    return cells


def write_map(folder, name, negate=0):
    path = folder / "some.yaml"
    path.write_text(ABOUT.format(name, negate))
    return path


@pytest.fixture
def as_pgm(tmp_path):
    (tmp_path / "some.pgm").write_bytes(b"P5\n80 60\n255\n" + levels().tobytes())
    return load_world(write_map(tmp_path, "some.pgm"))


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "LA", "P", "I;16", "1"])
def test_a_png_makes_the_same_world_as_a_pgm(tmp_path, as_pgm, mode):
    picture = Image.fromarray(levels())
    if mode == "I;16":
        picture = Image.fromarray(levels().astype(np.uint16) * 257)
    elif mode == "1":
        picture = Image.fromarray(levels() > 0)
    elif mode != "L":
        picture = picture.convert(mode)
    picture.save(tmp_path / "some.PNG")
    assert load_world(write_map(tmp_path, "some.PNG")) == as_pgm


def test_negate_inverts_a_png_too(tmp_path, as_pgm):
    Image.fromarray(255 - levels()).convert("RGB").save(tmp_path / "some.png")
    assert load_world(write_map(tmp_path, "some.png", negate=1)) == as_pgm


def refusal(tmp_path, content):
    (tmp_path / "some.png").write_bytes(content)
    with pytest.raises(ValueError) as caught:
        load_world(write_map(tmp_path, "some.png"))
    assert "image 'some.png': " in str(caught.value)
    return str(caught.value)


def huge_png(side):
    """A few hundred bytes whose header promises side x side pixels."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("side", [6001, 2_000_000])
def test_a_picture_with_too_many_pixels_is_refused_before_it_is_unpacked(tmp_path, side):
    message = refusal(tmp_path, huge_png(side))
    assert "pixels" in message


def test_damaged_pictures_are_refused(tmp_path):
    file = io.BytesIO()
    Image.fromarray(levels()).save(file, "PNG")
    whole = file.getvalue()
    assert "no PNG file" in refusal(tmp_path, b"P5\n80 60\n255\n" + levels().tobytes())
    for cut in (0, 5, 20, 40, len(whole) // 2):
        assert "cannot be read" in refusal(tmp_path, whole[:cut])
    with pytest.raises(ValueError):
        read_levels(tmp_path / "missing.png")
