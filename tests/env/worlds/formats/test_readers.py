"""Other people's maps: read as what they show, or refused with file and reason; plans of real
buildings are usable.
"""

import codecs
import json
import math
import re

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from support.data import data_folder

from limslam_env import World, load_world
from limslam_env.geometry import FloatArray, segment

RADIUS = 0.10
PLAN = {
    "id": "plan",
    "wall_thickness": 0.1,
    "walls": [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]],
}
HOUSE = {
    "id": "house",
    "room_num": 1,
    "bbox": {"min": [0, 0], "max": [4, 3]},
    "verts": [[0, 0], [4, 0], [4, 3], [0, 3]],
    "room_category": {"Hall": [[0, 0, 4, 3]]},
}
MAP = {
    "image": "map.pgm",
    "resolution": 0.5,
    "origin": [1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
ROOM = """
    ##########
    #........#
    #..###...#
    #..###...#
    #........#
    ##########
"""


def levels(picture: str, largest: int = 255) -> np.ndarray:
    """Cells from a drawing: # is occupied, . is free, ? is unknown."""
    shades = {"#": 0.0, ".": 254 / 255, "?": 205 / 255}
    return np.array([[round(shades[c] * largest) for c in row] for row in picture.split()])


def binary_pgm(cells: np.ndarray, largest: int = 255) -> bytes:
    kind = ">u1" if largest < 256 else ">u2"
    return (
        b"P5\n%d %d\n%d\n" % (cells.shape[1], cells.shape[0], largest)
        + cells.astype(kind).tobytes()
    )


def plain_pgm(cells: np.ndarray, largest: int = 255) -> bytes:
    rows = "\n".join(" ".join(map(str, row)) for row in cells.tolist())
    return f"P2\n{cells.shape[1]} {cells.shape[0]}\n{largest}\n{rows}\n".encode()


def write_map(folder, pgm: bytes | str, **changes):
    """A map's two files; a change to None takes the key away."""
    table = {key: value for key, value in {**MAP, **changes}.items() if value is not None}
    (folder / "map.pgm").write_bytes(binary_pgm(levels(pgm)) if isinstance(pgm, str) else pgm)
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(table), encoding="utf-8")
    return path


def write_json(folder, table, name: str = "plan.json"):
    path = folder / name
    path.write_text(table if isinstance(table, str) else json.dumps(table), encoding="utf-8")
    return path


def segment_set(edges: FloatArray) -> set[frozenset[tuple[float, float]]]:
    """Segments without direction, to the micrometre."""
    return {
        frozenset(map(tuple, pair.tolist())) for pair in np.round(edges.reshape(-1, 2, 2), 6) + 0.0
    }


def box(x1: float, y1: float, x2: float, y2: float) -> set[frozenset[tuple[float, float]]]:
    return segment_set(
        np.array([[x1, y1, x2, y1], [x2, y1, x2, y2], [x2, y2, x1, y2], [x1, y2, x1, y1]])
    )


def obstacle_edges(world: World) -> FloatArray:
    return world.edges[len(world.walls) :]


class TestMapServer:
    def test_a_room_with_a_pillar_is_where_it_stands(self, tmp_path):
        world = load_world(write_map(tmp_path, ROOM))
        # 10 x 6 cells of 0.5 m from (1, 2). Outlines run a quarter of a cell, 0.125 m, inside the
        # occupied cells.
        assert (world.name, world.size) == ("map", (5.0, 3.0))
        assert segment_set(world.walls) == box(1.125, 2.125, 5.875, 4.875) | box(
            1.375, 2.375, 5.625, 4.625
        )
        # The pillar: columns 3 to 5, rows 2 and 3 from the top: 2.5 to 4 m, and 3 to 4 m.
        assert segment_set(obstacle_edges(world)) == box(2.625, 3.125, 3.875, 3.875)
        assert len(world.obstacles) == 1
        world.check(RADIUS)

    def test_the_origins_yaw_turns_the_map_round_its_lower_left_corner(self, tmp_path):
        world = load_world(write_map(tmp_path, ROOM, origin=[1.0, 2.0, math.pi / 2]))
        # (u, v) of the picture becomes (1 - v, 2 + u).
        np.testing.assert_allclose(world.size, (3.0, 5.0))
        assert segment_set(world.walls) == box(0.875, 2.125, -1.875, 6.875) | box(
            0.625, 2.375, -1.625, 6.625
        )
        assert segment_set(obstacle_edges(world)) == box(-0.125, 3.625, -0.875, 4.875)

    @pytest.mark.parametrize(
        "pgm",
        [
            plain_pgm(levels(ROOM)),
            plain_pgm(levels(ROOM, 7), 7),
            plain_pgm(levels(ROOM, 65535), 65535),
            binary_pgm(levels(ROOM, 100), 100),
            binary_pgm(levels(ROOM, 1000), 1000),
            # With the bytes of 255 the wrong way round, black would be white.
            binary_pgm(np.where(levels(ROOM) == 0, 255, 65280), 65535),
            binary_pgm(levels(ROOM)).replace(b"P5\n", b"P5\n# made by hand\n#\n"),
            binary_pgm(levels(ROOM)).replace(b"10 6\n", b"10 # columns\r\n# 5 5\n6\n"),
            plain_pgm(levels(ROOM)).replace(b"255\n", b"255\n# the first row # is all walls\n", 1),
            binary_pgm(levels(ROOM)) + b"\nwhat follows is another picture",
        ],
        ids=[
            "P2",
            "3 bits",
            "P2, 16 bits",
            "100",
            "1000",
            "byte order",
            "comments",
            "between",
            "within",
            "trailing",
        ],
    )
    def test_every_kind_of_pgm_shows_the_same_world(self, tmp_path, pgm):
        expected = load_world(write_map(tmp_path, ROOM))
        assert load_world(write_map(tmp_path, pgm)) == expected

    def test_a_negated_map_has_white_walls(self, tmp_path):
        expected = load_world(write_map(tmp_path, ROOM))
        negative = binary_pgm(255 - levels(ROOM))
        assert load_world(write_map(tmp_path, negative, negate=1)) == expected
        assert load_world(write_map(tmp_path, negative, negate=True)) == expected
        assert load_world(write_map(tmp_path, negative)) != expected

    def test_only_cells_above_the_threshold_are_walls(self, tmp_path):
        pgm = plain_pgm(np.array([[4, 4, 4, 4], [4, 1, 1, 4], [4, 2, 2, 4]]), 4)
        # Shades of 3/4 and 2/4 are above 0.4; 3/4 alone is above 0.5, which 2/4 is not.
        both = load_world(write_map(tmp_path, pgm, occupied_thresh=0.4))
        upper = load_world(write_map(tmp_path, pgm, occupied_thresh=0.5, free_thresh=0.5))
        assert segment_set(both.edges) == box(1.625, 2.125, 2.375, 2.875)
        assert upper.edges[:, [1, 3]].min() > 2.5

    @pytest.mark.parametrize(
        "changes", [{"mode": "Trinary"}, {"mode": "SCALE"}, {"resolution": "5e-1"}, {"extra": 1}]
    )
    def test_what_changes_no_wall_is_read_alike(self, tmp_path, changes):
        expected = load_world(write_map(tmp_path, ROOM))
        path = write_map(tmp_path, ROOM, **changes)
        path.write_text(
            path.read_text(encoding="utf-8").replace("'5e-1'", "5e-1"), encoding="utf-8"
        )
        assert load_world(path) == expected

    def test_the_image_may_lie_in_another_folder(self, tmp_path):
        expected = load_world(write_map(tmp_path, ROOM))
        (tmp_path / "images").mkdir()
        path = write_map(tmp_path, ROOM, image="images/big.PGM")
        (tmp_path / "map.pgm").rename(tmp_path / "images" / "big.PGM")
        assert load_world(path) == expected
        path.write_bytes(codecs.BOM_UTF8 + path.read_bytes().replace(b"\n", b"\r\n"))
        assert load_world(path) == expected

    def test_a_slanting_staircase_becomes_straight(self, tmp_path):
        cells = np.full((60, 120), 254)
        column = np.arange(5, 115)
        for thickness in range(4):
            cells[column // 3 + 10 + thickness, column] = 0
        world = load_world(write_map(tmp_path, binary_pgm(cells)))
        assert len(world.edges) == 4
        assert np.sort(segment.lengths(world.edges))[2:] == pytest.approx(
            0.5 * math.hypot(109, 36), abs=0.75
        )


def fits(world: World, x: float, y: float) -> bool:
    return world.free_space(RADIUS).label_of(np.array([x, y])) > 0


def write_fine(folder, cells: np.ndarray | str, **changes):
    """A map with five cells of 0.1 m for each side of a letter, or of a level."""
    coarse = levels(cells) if isinstance(cells, str) else cells
    pgm = binary_pgm(coarse.repeat(5, axis=0).repeat(5, axis=1))
    return write_map(folder, pgm, resolution=0.1, **changes)


class TestUnknownCells:
    """Maps of cells of 0.1 m, five for each side of a letter, from (1, 2): robots stay on free
    ones.
    """

    def test_what_walls_enclose_of_unknown_cells_is_no_room(self, tmp_path):
        picture = """
            ????????????????
            ?##############?
            ?#............#?
            ?#..########..#?
            ?#..#??????#..#?
            ?#..#??????#..#?
            ?#..#??????#..#?
            ?#..#??????#..#?
            ?#..########..#?
            ?#............#?
            ?##############?
            ????????????????
        """
        world = load_world(write_fine(tmp_path, picture))
        # The 6 x 4 unknown cells are more than any part of the free ring is wide.
        assert world.notes == ("6.0 m^2 within the map are unknown, and are no floor",)
        assert not fits(world, 5.0, 5.0)
        assert fits(world, 2.5, 5.0)
        world.check(RADIUS)
        region = world.free_space(RADIUS).largest_closed_region()
        starts = world.free_space(RADIUS).centres(region)
        columns, rows = ((starts - (1.0, 2.0)) // 0.5).astype(int).T
        assert {picture.split()[11 - row][column] for row, column in zip(rows, columns)} == {"."}  # noqa: B905

    def test_unknown_rooms_of_any_shape_are_no_floor(self, tmp_path):
        picture = """
            ################
            #??????????????#
            #??##########??#
            #??#........#??#
            #??#........#??#
            #??#........#??#
            #??##########??#
            #??????????????#
            #??????????????#
            #??????????????#
            #######..#######
            #######..#######
            ################
        """
        world = load_world(write_fine(tmp_path, picture))
        region = world.free_space(RADIUS).largest_closed_region()
        x, y = world.free_space(RADIUS).centres(region).T
        # Without the unknown ring, the hall of 8 x 3 cells is the largest.
        assert (x.min(), x.max()) == (pytest.approx(3.0, abs=0.3), pytest.approx(7.0, abs=0.3))
        assert (y.min(), y.max()) == (pytest.approx(5.5, abs=0.3), pytest.approx(7.0, abs=0.3))

    def test_a_wall_stands_where_free_ground_ends_and_the_map_does_not_know_why(self, tmp_path):
        picture = """
            ??????????
            ?########?
            ?#......#?
            ?#.......?
            ?#......#?
            ?########?
            ??????????
        """
        world = load_world(write_fine(tmp_path, picture))
        world.check(RADIUS)
        assert world.notes == (
            "the map does not know what ends its free ground along 0.5 m: walls stand there",
        )
        assert fits(world, 4.75, 3.75)
        assert not fits(world, 5.5, 3.75)

    def test_unknown_cells_that_the_file_calls_free_are_named(self, tmp_path):
        picture = ROOM.replace("###...", "???...")
        world = load_world(write_fine(tmp_path, picture, free_thresh=0.25))
        (note,) = world.notes
        assert "level 205" in note
        assert "free by free_thresh 0.25" in note
        assert fits(world, 3.25, 3.5)

    def test_a_hole_in_the_known_ground_holds_robots(self, tmp_path):
        picture = "##########\n#........#\n#...??...#\n#........#\n##########"
        world = load_world(write_fine(tmp_path, picture))
        assert not fits(world, 3.5, 3.25)
        assert box(3.025, 3.025, 3.975, 3.475) <= segment_set(obstacle_edges(world))

    def test_scale_leaves_what_is_neither_free_nor_occupied_and_what_is_transparent(self, tmp_path):
        cells = levels(ROOM)
        cells[1:5, 6] = 150  # a shade of 0.41
        path = write_fine(tmp_path, cells, mode="Scale")
        assert not fits(load_world(path), 4.25, 2.75)
        cells = cells.repeat(5, axis=0).repeat(5, axis=1)
        opacity = np.where(cells == 150, 254, 255).astype(np.uint8)
        shown = np.where(cells == 150, 254, cells).astype(np.uint8)
        cv2.imwrite(str(tmp_path / "map.png"), np.dstack((shown, shown, shown, opacity)))
        for mode, is_floor in (("scale", False), ("trinary", True)):
            world = load_world(write_fine(tmp_path, ROOM, image="map.png", mode=mode))
            assert fits(world, 4.25, 2.75) == is_floor

    def test_raw_levels_are_percents_and_higher_ones_unknown(self, tmp_path):
        cells = np.select([levels(ROOM) == 0, levels(ROOM) > 250], [100, 10])
        raw = load_world(write_fine(tmp_path, cells, mode="raw"))
        assert raw == load_world(write_fine(tmp_path, ROOM))
        cells[2, 4] = 255
        cells[1, 1] = 50
        raw = load_world(write_fine(tmp_path, cells, mode="RAW"))
        assert not fits(raw, 1.75, 4.25)
        assert "0.5 m^2 within the map are unknown, and are no floor" in raw.notes


def yaml_with(line: str) -> str:
    """The map's YAML with another line for the key that the line begins with."""
    key = line.partition(":")[0]
    rows = yaml.safe_dump(MAP, default_flow_style=None).splitlines()
    return "\n".join(line if row.startswith(key) else row for row in rows)


class TestMapsRefused:
    @pytest.mark.parametrize("key", list(MAP))
    def test_every_key_is_needed(self, tmp_path, key):
        with pytest.raises(ValueError, match=rf"map\.yaml: the key '{key}' is missing"):
            load_world(write_map(tmp_path, ROOM, **{key: None}))

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            (yaml_with("image: 3"), "image must be a file's name"),
            (
                yaml_with("image: map.gif"),
                r"image 'map\.gif': not a picture that can be read \(\.pgm,",
            ),
            (yaml_with("image: other.pgm"), r"image 'other\.pgm': no such file"),
            (yaml_with('image: "nul\\0.pgm"'), r"image 'nul\\x00\.pgm': no such file"),
            (yaml_with("resolution: 0"), r"resolution must be a number from 0\.001 to 10"),
            (yaml_with("resolution: .nan"), "resolution must be a number"),
            (yaml_with("resolution: fine"), "resolution must be a number"),
            (yaml_with(f"resolution: {'9' * 5000}"), "not a map's YAML"),
            (yaml_with("origin: [0, 0]"), "origin must be three numbers"),
            (yaml_with("origin: [0, 0, up]"), "origin must be a number"),
            (yaml_with("origin: [1e5, 0, 0]"), "walls reach further than 500 m"),
            (yaml_with("origin: [[0], 0, 0]"), "nested deeper"),
            (yaml_with("negate: 2"), "negate must be a number from 0 to 1"),
            (yaml_with("negate: 0.5"), "negate must be 0 or 1"),
            (yaml_with("occupied_thresh: 1.5"), "occupied_thresh must be a number from 0 to 1"),
            (yaml_with("free_thresh: 0.7"), r"free_thresh must be a number from 0 to 0\.65"),
            (yaml_with("negate: 0") + "\nmode: grey", "mode must be one of trinary, scale, raw"),
            (yaml_with("origin: &a [*a, 0, 0]"), "neither aliases nor tags"),
            (yaml_with("image: !!python/object/apply:os.getcwd []"), "neither aliases nor tags"),
            ("[" * 90_000, "nested deeper than a map is"),
            ("just a text", "no table of keys and values"),
            ("#" * 100_001, r"larger than 0\.1 MB"),
        ],
        ids=lambda value: re.sub(r"\W+", "-", value)[-30:],
    )
    def test_yaml_that_describes_no_map_is_refused(self, tmp_path, text, reason):
        path = write_map(tmp_path, ROOM)
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=rf"^[^\n]*map\.yaml: [^\n]*(?:{reason})[^\n]*$"):
            load_world(path)

    @pytest.mark.parametrize(
        ("pgm", "reason"),
        [
            (b"", "no PGM file"),
            (b"P5\n4 4", "cannot be read"),
            (b"P5\n-4 4\n255\n" + bytes(16), "cannot be read"),
            (b"P5\n100000 100000\n255\n", "pixels"),
            (b"P5\n4 4\n65536\n" + bytes(64), "cannot be read"),
            (b"P5\n4 4\n255\n" + bytes(15), "truncated"),
            (b"P2\n4 4\n255\n" + b"0 " * 15, "cannot be read|truncated"),
            (b"P2\n4 4\n255\n" + b"0 " * 15 + b"256", "cannot be read"),
            (b"P5\n4 4\n255\n" + b"\xff" * 16, "no cell is occupied"),
        ],
    )
    def test_a_picture_that_is_no_map_is_refused(self, tmp_path, pgm, reason):
        with pytest.raises(ValueError, match=rf"^[^\n]*map\.yaml: [^\n]*(?:{reason})[^\n]*$"):
            load_world(write_map(tmp_path, pgm))

    def test_a_map_wider_than_a_world_is_refused(self, tmp_path):
        cells = np.full((4, 60), 254)
        cells[1] = 0
        with pytest.raises(ValueError, match=r"map\.yaml: size must be two lengths up to 500 m"):
            load_world(write_map(tmp_path, binary_pgm(cells), resolution=10.0))

    def test_noise_is_refused_before_it_takes_minutes(self, tmp_path):
        cells = np.random.default_rng(0).integers(0, 2, (2000, 2000)) * 254
        with pytest.raises(ValueError, match="more than 1000000 corners"):
            load_world(write_map(tmp_path, binary_pgm(cells), resolution=0.05))
        dots = np.full((400, 600), 254)
        dots[::3, ::3] = 0
        with pytest.raises(ValueError, match="26800 separate outlines"):
            load_world(write_map(tmp_path, binary_pgm(dots), resolution=0.05))


class TestPlans:
    def test_a_wall_list_is_its_walls(self, tmp_path):
        world = load_world(write_json(tmp_path, PLAN))
        assert (world.name, world.size, world.obstacles) == ("plan", (4.0, 3.0), ())
        np.testing.assert_array_equal(world.walls, PLAN["walls"])
        world.check(RADIUS)

    def test_json_with_the_keys_of_toml_is_the_same_world(self, tmp_path):
        world = load_world("env2")
        table = {
            "name": world.name,
            "size": world.size,
            "walls": world.walls.tolist(),
            "obstacles": [polygon.tolist() for polygon in world.obstacles],
            **{
                key: getattr(world, key).tolist()
                for key in ("doors", "starts", "loop")
                if len(getattr(world, key))
            },
        }
        assert load_world(write_json(tmp_path, table)) == world

    def test_walls_without_length_are_dropped(self, tmp_path):
        walls = [*PLAN["walls"][:2], [1, 1, 1, 1], *PLAN["walls"][2:], [2, 2, 2 + 1e-7, 2]]
        assert load_world(write_json(tmp_path, {**PLAN, "walls": walls})) == load_world(
            write_json(tmp_path, PLAN)
        )

    def test_a_house_is_its_closed_outline(self, tmp_path):
        world = load_world(write_json(tmp_path, HOUSE))
        assert (world.name, world.size) == ("house", (4.0, 3.0))
        assert segment_set(world.walls) == box(0.0, 0.0, 4.0, 3.0)
        assert len(world.walls) == 4
        world.check(RADIUS)

    def test_what_is_not_used_may_be_missing_or_anything(self, tmp_path):
        expected = load_world(write_json(tmp_path, PLAN))
        assert load_world(write_json(tmp_path, {**PLAN, "wall_thickness": [None]})) == expected
        assert load_world(write_json(tmp_path, {"id": "plan", "walls": PLAN["walls"]})) == expected

    @pytest.mark.parametrize(
        ("content", "reason"),
        [
            (b"", "not JSON"),
            (b"\xff\xfe", "cannot be read: 'utf-8'"),
            (b"[" * 100_000, "not JSON"),
            (b"[1, 2]", "no table of keys and values"),
            (b"{}", "neither 'walls'.* nor 'verts'"),
            (b'{"id": "n", "walls": [[NaN, 0, 1, 1]]}', "not JSON: NaN is no number"),
            (b'{"id": "n", "walls": [[0, 0, 1e999, 1]]}', "walls reaches further than 500 m"),
            (
                b'{"id": "n", "walls": [[0, 0, %s, 1]]}' % (b"9" * 400),
                "walls must be a list of lists of numbers",
            ),
            (
                b'{"id": "n", "walls": [[0, 0, true, 1]]}',
                "walls must be a list of lists of numbers",
            ),
            (
                b'{"id": "n", "walls": [[0, 0, 1, 1], [0, 0, 1]]}',
                r"walls\[1\] has 3 numbers, and walls\[0\] has 4",
            ),
            (b'{"id": "n", "walls": [[0, 0, 1]]}', "walls must have 4 numbers a row, not 3"),
            (b'{"id": "n", "walls": []}', "walls is empty"),
            (b'{"id": "n", "walls": [[0, 1, 2, 1]]}', "stand on one line and enclose nothing"),
            (
                b'{"name": "n", "size": [1, 1], "walls": [[0, 0, 1, 1]], "start": [[0, 0, 0]]}',
                "unknown key 'start'",
            ),
            (b'{"id": 7, "walls": [[0, 0, 1, 1]]}', "id must be a text"),
            (b'{"id": "\\ud800", "walls": [[0, 0, 1, 1]]}', "holds an invalid character"),
            (b'{"id": "n", "verts": [[0, 0, 0]]}', "verts must have 2 numbers a row, not 3"),
            (b'{"id": "n", "verts": [[0, 0], [1, 1]]}', "fewer than three corners"),
            (b'{"verts": [[0, 0], [1, 1], [1, 0]]}', "the key 'id' is missing"),
        ],
    )
    def test_json_that_is_no_plan_is_refused(self, tmp_path, content, reason):
        path = tmp_path / "plan.json"
        path.write_bytes(content)
        with pytest.raises(ValueError, match=rf"^[^\n]*plan\.json: [^\n]*{reason}[^\n]*$"):
            load_world(path)

    def test_more_walls_than_can_be_used_are_refused(self, tmp_path):
        path = write_json(tmp_path, {"id": "n", "walls": [[0, 0, 1, 1]] * 100_001})
        with pytest.raises(ValueError, match=r"plan\.json: 100001 walls and obstacle edges"):
            load_world(path)

    @pytest.mark.parametrize("name", ["map.gif", "plan"])
    def test_other_files_are_refused_with_those_that_can_be_read(self, tmp_path, name):
        kinds = r"\.toml, \.yaml, \.json, \.png, \.pgm, \.jpg, \.jpeg, \.bmp, \.svg, \.dxf"
        with pytest.raises(
            ValueError, match=rf"{name}: not a world file that can be read \({kinds}\)"
        ):
            load_world(write_json(tmp_path, PLAN, name))


class TestRealPlans:
    def test_all_plans_load_and_a_part_of_them_is_checked(self):
        files = sorted((data_folder() / "kth").glob("*.json"))
        assert len(files) == 40
        dropped = 0
        for number, path in enumerate(files):
            world = load_world(path)
            if number % 4 == 0:  # a check of all plans takes many seconds
                world.check(RADIUS)
            table = json.loads(path.read_text(encoding="utf-8"))
            assert world.name == table["id"]
            dropped += len(table["walls"]) - len(world.walls)
        assert dropped == 1

    @pytest.mark.parametrize(("radius", "turn"), [(0.07, 0.0), (0.25, 0.4)])
    def test_a_disc_fits_where_no_edge_is_near_and_no_polygon_around(self, radius, turn):
        generator = np.random.default_rng(3)
        polygons = [
            generator.uniform(0.0, 4.0, 2) + generator.uniform(-1.0, 1.0, (n, 2)) for n in (3, 4, 7)
        ]
        polygons.append(np.array([[0.5, 0.5], [1.0, 0.5], [1.0, 1.0], [0.5, 1.0]]))
        walls = np.vstack(
            (
                generator.uniform(0.0, 5.0, (20, 4)),
                [[0, 0, 5, 0], [0, 0, 0, 5], [2, 2, 2, 2.000002]],
            )
        )
        rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        world = World(
            "n",
            (5.0, 5.0),
            (walls.reshape(-1, 2) @ rotation).reshape(-1, 4),
            tuple(polygon @ rotation for polygon in polygons),
        )
        space = world.free_space(radius)
        centres = space.centres(np.ones_like(space.free))
        expected = (segment.distances(centres, world.edges) >= radius).all(axis=1)
        for polygon in world.obstacles:
            expected &= ~segment.inside_polygon(centres, polygon)
        np.testing.assert_array_equal(space.free.ravel(), expected)
        np.testing.assert_array_equal(space.first_centre(space.free), space.centres(space.free)[0])


NASTY = [
    *(
        "!!int ''",
        "0b_",
        "2001-99-99",
        "2001-01-01 0:0:0 +99:99",
        "&a [*a]",
        "[" * 2000,
        "1e999",
        "? [a]\n: b",
    ),
    *(
        '"\\ud800"',
        '"\\0.pgm"',
        "9" * 5000,
        "190:20:30",
        "<<: {a: 1}",
        "%YAML 9.9\n---",
        "!<tag:x> y",
        "*a",
        "|\n a",
    ),
    *(
        "null",
        "{}",
        "'",
        "---\n",
        "\x85",
        "../map.yaml",
        "/dev/zero",
        "map.pgm",
        "1_0.5",
        "\ufeff",
        "=",
        "#",
        "a: " * 1000,
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("values")
    write_map(folder, ROOM)
    return folder


def outcome(path, content: bytes) -> None:
    """Write and load a file; a world or a one-line refusal, anything else fails the test."""
    path.write_bytes(content)
    try:
        world = load_world(path)
    except ValueError as error:
        assert path.name in str(error)  # noqa: PT017 - a world is as good an outcome
        assert "\n" not in str(error)  # noqa: PT017
        return
    assert isinstance(world, World)
    assert np.isfinite(world.edges).all()


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from([10**400, -1, 0, 1, "map.pgm", "trinary"]),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)
ROWS = st.lists(st.lists(st.floats() | st.integers(-600, 600), max_size=5), max_size=5)


@given(key=st.sampled_from(["id", "walls", "verts"]), value=VALUES | ROWS)
@settings(deadline=None, max_examples=150)
def test_any_json_value_is_a_world_or_refused(folder, key, value):
    for table in ({**PLAN, key: value}, {**HOUSE, key: value}, value):
        outcome(folder / "plan.json", json.dumps(table).encode())


@given(key=st.sampled_from([*MAP, "mode"]), value=VALUES)
@settings(deadline=None, max_examples=100)
def test_any_yaml_value_is_a_world_or_refused(folder, key, value):
    outcome(
        folder / "map.yaml", yaml.safe_dump({**MAP, key: value}).encode("utf-8", "surrogatepass")
    )


@pytest.mark.parametrize("nasty", NASTY, ids=range(len(NASTY)))
def test_the_ways_to_upset_a_yaml_parser_upset_nothing(folder, nasty):
    for content in (
        nasty,
        *(yaml_with(f"{key}: {nasty}") for key in MAP),
        f"{yaml_with('negate: 0')}\n{nasty}",
    ):
        outcome(folder / "map.yaml", content.encode("utf-8", "surrogatepass"))


def test_a_large_file_says_what_is_being_done(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("LIMSLAM_QUIET", "")
    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    load_world(tmp_path / "plan.json")
    assert capsys.readouterr().err == ""
    (tmp_path / "plan.json").write_text(json.dumps(PLAN) + " " * 1_100_000)
    load_world(tmp_path / "plan.json")
    assert "plan.json: a world of 1.1 MB is read and checked" in capsys.readouterr().err
