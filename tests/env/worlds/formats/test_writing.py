"""Files of worlds: TOML and maps that read back as the same world, and pictures as they are
read.
"""

import io
import stat
import struct
import zlib

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

from limslam_env import World, load_world
from limslam_env.geometry import segment
from limslam_env.worlds.formats.loading import write_world
from limslam_env.worlds.formats.pictures import read_picture
from limslam_env.worlds.formats.tables import parse_world, world_toml

BOX = np.array(
    [[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 1.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]]
)


def box_world(**changes) -> World:
    return World(**{"name": "box", "size": (1.0, 1.0), "walls": BOX, **changes})


LENGTHS = st.floats(-250.0, 250.0)
ANY = st.floats(-1e7, 1e7)


def rows(width: int, numbers=LENGTHS, **limits):
    return st.lists(st.tuples(*[numbers] * width), **limits).map(
        lambda found: np.array(found).reshape(-1, width)
    )


@st.composite
def worlds(draw) -> World:
    try:
        return World(
            name=draw(st.text(max_size=20)),
            size=draw(st.tuples(*[st.floats(0.0, 500.0, exclude_min=True)] * 2)),
            walls=draw(rows(4, max_size=4)),
            obstacles=tuple(draw(st.lists(rows(2, min_size=3, max_size=5), max_size=3))),
            doors=draw(rows(4, ANY, max_size=2)),
            starts=draw(rows(3, ANY, max_size=3)),
            loop=draw(rows(2, ANY, max_size=3)),
        )
    except ValueError:  # nothing that stops a beam, or an edge without length
        assume(condition=False)
        raise


class TestToml:
    @given(worlds())
    @settings(deadline=None, max_examples=150)
    def test_every_world_reads_back_as_itself(self, world):
        assert parse_world(world_toml(world), "again") == world

    @pytest.mark.parametrize(
        "name",
        [
            'back\\slash \\u0041 and """',
            "ünïcödé 建物 🏠",
            "\ufeffmark \u2028 \u0085 \x7f",
            "".join(map(chr, range(32))),
        ],
        ids=range(4),
    )
    def test_every_name_reads_back_from_a_file(self, tmp_path, name):
        world = box_world(name=name)
        write_world(world, tmp_path / "w.toml")
        assert load_world(tmp_path / "w.toml") == world

    def test_it_is_written_as_people_write_it(self):
        world = box_world(
            walls=BOX[:2], obstacles=(np.array([[0.25, 0.25], [0.5, 0.25], [0.5, 1e-7]]),)
        )
        assert world_toml(world) == (
            'name = "box"\n'
            "size = [1.0, 1.0]\n"
            "walls = [\n"
            "    [0.0, 0.0, 1.0, 0.0],\n"
            "    [1.0, 0.0, 1.0, 1.0],\n"
            "]\n"
            "obstacles = [\n"
            "    [[0.25, 0.25], [0.5, 0.25], [0.5, 1e-07]],\n"
            "]\n"
        )


class TestMaps:
    def test_a_map_is_the_picture_that_it_should_be(self, tmp_path):
        # A room of 1 x 0.75 m, in which a short wall stands on the lower left; cells of 0.25 m.
        walls = np.array(
            [
                [0, 0, 1, 0],
                [1, 0, 1, 0.75],
                [1, 0.75, 0, 0.75],
                [0, 0.75, 0, 0],
                [0.25, 0, 0.25, 0.25],
            ]
        )
        write_world(box_world(walls=walls - 10.0), tmp_path / "map.yaml", resolution=0.25)
        picture = """
            ?????????????
            ?????????????
            ?????????????
            ?????????????
            ????#####????
            ????#...#????
            ????##..#????
            ????#####????
            ?????????????
            ?????????????
            ?????????????
            ?????????????
        """
        expected = [
            [{"#": 0, ".": 254, "?": 205}[letter] for letter in row] for row in picture.split()
        ]
        assert (tmp_path / "map.pgm").read_bytes() == b"P5\n13 12\n255\n" + np.array(
            expected, np.uint8
        ).tobytes()
        # OpenCV reads it as we do, and the corner is four and a half cells from the walls.
        np.testing.assert_array_equal(
            cv2.imread(str(tmp_path / "map.pgm"), cv2.IMREAD_UNCHANGED), expected
        )
        assert yaml.safe_load((tmp_path / "map.yaml").read_text(encoding="utf-8")) == {
            "image": "map.pgm",
            "resolution": 0.25,
            "origin": [-11.125, -11.125, 0.0],
            "negate": 0,
            "occupied_thresh": 0.65,
            "free_thresh": 0.196,
        }

    def test_an_obstacle_is_black_all_through(self, tmp_path):
        block = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]])
        write_world(box_world(obstacles=(block,)), tmp_path / "map.yaml", resolution=0.1)
        levels = cv2.imread(str(tmp_path / "map.pgm"), cv2.IMREAD_UNCHANGED)
        # Walls at cells 4 and 14 of 19, the block from 6 to 12.
        assert levels.shape == (19, 19)
        assert (levels[6:13, 6:13] == 0).all()
        assert (levels == 0).sum() == 7 * 7 + 4 * 10
        assert (levels == 254).sum() == 9 * 9 - 7 * 7

    @pytest.mark.parametrize(("name", "resolution"), [("env1", 0.05), ("square", 0.1)])
    def test_a_map_reads_back_with_its_walls_where_they_were(self, tmp_path, name, resolution):
        world = load_world(name)
        write_world(world, tmp_path / "map.yaml", resolution)
        again = load_world(tmp_path / "map.yaml")
        for first, second in ((world, again), (again, world)):
            points, _ = segment.sample(first.edges, 0.5 * resolution)
            assert segment.distances(points, second.edges).min(axis=1).max() <= 1.5 * resolution
        again.check(0.10)
        # Straight walls are single ones, and the block in the middle is still a block.
        assert len(again.edges) <= 2 * len(world.edges)
        assert [len(polygon) for polygon in again.obstacles] == [4]
        np.testing.assert_allclose(again.size, np.array(world.size) + 9.0 * resolution)

    @pytest.mark.parametrize("name", ["a: b # c", "'\""])
    def test_any_file_name_will_do(self, tmp_path, name):
        write_world(box_world(), tmp_path / f"{name}.yml")
        assert load_world(tmp_path / f"{name}.yml").name == name


class TestRefused:
    @pytest.mark.parametrize("name", ["w.json", "w.pgm", "w", ".toml"])
    def test_an_unknown_suffix(self, tmp_path, name):
        with pytest.raises(ValueError, match=rf"{name}: a world is written as \.toml or \.yaml"):
            write_world(box_world(), tmp_path / name)
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("resolution", [0.0009, 10.1, float("nan")])
    def test_a_resolution_that_no_map_has(self, tmp_path, resolution):
        with pytest.raises(ValueError, match=r"m\.yaml: cells must measure 0\.001 to 10 m"):
            write_world(box_world(), tmp_path / "m.yaml", resolution)

    def test_more_cells_than_can_be_read(self, tmp_path):
        large = box_world(size=(500.0, 500.0), walls=BOX * 500.0)
        with pytest.raises(
            ValueError, match=r"m\.yaml: 500009 x 500009 cells of 0\.001 m; a map has up to"
        ):
            write_world(large, tmp_path / "m.yaml", 0.001)

    @pytest.mark.parametrize("name", ["w.toml", "w.yaml"])
    def test_a_place_where_nothing_can_be_written(self, tmp_path, name):
        with pytest.raises(ValueError, match=rf"{name[0]}\.\w+: cannot be written"):
            write_world(box_world(), tmp_path / "missing" / name)
        (tmp_path / name).mkdir()
        (tmp_path / "w.pgm").mkdir()
        with pytest.raises(ValueError, match="cannot be written"):
            write_world(box_world(), tmp_path / name)
        assert {path.name for path in tmp_path.iterdir()} == {name, "w.pgm"}

    def test_a_file_is_replaced_whole_and_readable_like_others(self, tmp_path):
        path = tmp_path / "w.toml"
        other = tmp_path / "other"
        other.write_text("")
        path.write_text("old")
        write_world(box_world(), path)
        assert load_world(path) == box_world()
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(other.stat().st_mode)
        assert {found.name for found in tmp_path.iterdir()} == {"w.toml", "other"}


ABOUT = (
    "image: {}\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: {}\noccupied_thresh: "
    "0.65\nfree_thresh: 0.196\n"
)


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
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(1000)))
        + chunk(b"IEND", b"")
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
        read_picture(tmp_path / "missing.png")
