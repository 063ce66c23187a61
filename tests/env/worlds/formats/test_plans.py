"""Plans as pictures, SVG and DXF: what they show in metres, or why they are refused."""

import itertools

import cv2
import ezdxf
import numpy as np
import pytest
from PIL import Image

from limslam_env import World, load_world
from limslam_env.worlds.formats import dxf as dxf_module
from limslam_env.worlds.formats import svg as svg_module
from limslam_env.worlds.formats.loading import write_world
from limslam_env.worlds.regions import start_region

RADIUS = 0.10
INKSCAPE = """<?xml version="1.0" encoding="UTF-8"?>
<svg width="8000mm" height="6000mm" viewBox="0 0 8000 6000" xmlns="http://www.w3.org/2000/svg"
    xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
    xmlns:xlink="http://www.w3.org/1999/xlink">
  <defs><rect id="desk" width="800" height="400"/></defs>
  <g inkscape:groupmode="layer" inkscape:label="Walls" id="layer1" transform="translate(500,500)">
    <rect style="fill:none;stroke:#000" width="7000" height="5000"/>
    <path style="fill:none;stroke:#000" d="m 3000,0 v 2000 m 0,900 v 2100"/>
    <use xlink:href="#desk" x="5500" y="400" transform="rotate(90 5900 600)"/>
  </g>
  <g inkscape:groupmode="layer" inkscape:label="Doors" transform="translate(500,500)">
    <path d="M3000 2000 V 2900" stroke="red"/>
    <path d="M3000 2000 H 3900" stroke="red"/>
    <path d="M3900 2000 A900 900 0 0 1 3000 2900" fill="none" stroke="red"/>
  </g>
  <g inkscape:groupmode="layer" inkscape:label="Furniture">
    <rect x="900" y="900" width="500" height="500"/>
  </g>
</svg>"""
ROOM_LINES = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]]


def svg(body: str, attributes: str = 'width="10000mm" viewBox="0 0 10000 10000"') -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {attributes}>{body}</svg>'


ROOM = '<rect width="4000" height="3000" fill="none" stroke="black"/>'


def read_svg(folder, text: str, **arguments) -> World:
    path = folder / "plan.svg"
    path.write_text(text, encoding="utf-8")
    return load_world(path, **arguments)


def ends(lines) -> set[frozenset[tuple[float, float]]]:
    """Lines without direction, to the tenth of a millimetre."""
    pairs = np.round(np.asarray(lines, dtype=float).reshape(-1, 2, 2), 4) + 0.0
    return {frozenset(map(tuple, pair.tolist())) for pair in pairs}


def box(x1, y1, x2, y2):
    return ends([[x1, y1, x2, y1], [x2, y1, x2, y2], [x2, y2, x1, y2], [x1, y2, x1, y1]])


class TestSvg:
    def test_a_drawing_of_inkscape_is_its_layer_of_walls_in_metres(self, tmp_path):
        world = read_svg(tmp_path, INKSCAPE)
        # y is up, the lower left corner is (0, 0), and the desk stands upright around (5.9, 4.4).
        assert world.size == (7.0, 5.0)
        assert ends(world.walls) == (
            box(0, 0, 7, 5) | ends([[3, 5, 3, 3], [3, 2.1, 3, 0]]) | box(5.7, 4.0, 6.1, 4.8)
        )
        assert ends(world.doors) == ends([[3, 3, 3, 2.1]])
        assert world.notes == ("layers that are not used: Furniture",)
        world.check(RADIUS)

    def test_layers_are_chosen_by_name(self, tmp_path):
        world = read_svg(tmp_path, INKSCAPE, layers=["walls", "Furniture"])
        assert box(0.4, 4.1, 0.9, 4.6) <= ends(world.walls)
        with pytest.raises(ValueError, match="no lines are in a layer 'roof'; there are Walls, "):
            read_svg(tmp_path, INKSCAPE, layers=["Roof"])

    @pytest.mark.parametrize(
        "shape",
        [
            '<polygon points="0,0 4000,0 4000,3000 0,3000"/>',
            '<polyline points="0 0 4000 0 4000 3000 0 3000 0 0" style="fill:none;stroke:#000"/>',
            '<path d="M0,0H4000V3000H0Z"/>',
            '<path d="m0 0 4e3 0 0 3e3-4e3 0z"/>',
            '<g transform="matrix(1000 0 0 -1000 0 0)"><path d="M0 0L4 0 4 3 0 3Z"/></g>',
            '<g transform="translate(9000) rotate(90)"><rect width="3000" height="4000"/></g>',
            '<g transform="scale(2)"><svg><a><rect width="2000" height="1500"/></a></svg></g>',
            '<symbol id="s"><rect width="4000" height="3000"/></symbol><use href="#s"/>',
            '<g><path d="M0 0H4000V3000"/></g><g><line y1="3000"/><path d="M0 3000h4000"/></g>',
        ],
    )
    def test_the_same_room_is_drawn_in_many_ways(self, tmp_path, shape):
        world = read_svg(tmp_path, svg(shape))
        assert ends(world.walls) == box(0, 0, 4, 3)
        assert world.notes == ()

    def test_what_is_not_shown_is_no_wall(self, tmp_path):
        hidden = """
            <style>.page{fill:#FFF} .off{display:none}</style>
            <rect width="100%" height="100%" fill="red"/>
            <rect class="page" width="9000" height="9000"/>
            <g class="off"><rect width="8000" height="8000"/></g>
            <g style="visibility:hidden"><rect width="8000" height="8000"/></g>
            <rect fill="none" width="7000" height="8000"/>
            <clipPath><rect width="7000" height="8000"/></clipPath>
            <text x="9000">A</text><!-- a comment -->
        """
        assert ends(read_svg(tmp_path, svg(hidden + ROOM)).walls) == box(0, 0, 4, 3)

    def test_curves_keep_within_a_centimetre(self, tmp_path):
        circle = '<circle cx="2000" cy="1500" r="500"/>'
        world = read_svg(tmp_path, svg(ROOM + circle))
        corners = world.walls[4:].reshape(-1, 2)
        middles = (world.walls[4:, :2] + world.walls[4:, 2:]) / 2.0
        distance = np.hypot(*(np.vstack((corners, middles)) - (2.0, 1.5)).T)
        assert 8 < len(world.walls) - 4 < 40
        assert 0.49 - 1e-9 <= distance.min() <= distance.max() <= 0.5 + 1e-9
        bezier = '<path d="M1000 1000 C 1000 2000 2000 2000 2000 1000 Q 1500 500 1000 1000"/>'
        walls = read_svg(tmp_path, svg(ROOM + bezier)).walls[4:]
        np.testing.assert_array_equal(walls[:-1, 2:], walls[1:, :2])
        # At its middle the cubic curve is three quarters of the way to its control points.
        assert walls[:, [1, 3]].min() == pytest.approx(3.0 - 1.75, abs=0.01)

    def test_the_unit_is_that_of_the_width_or_is_asked_for(self, tmp_path):
        assert read_svg(
            tmp_path, svg(ROOM, 'width="400in" viewBox="0 0 4000 3000"')
        ).size == pytest.approx((10.16, 7.62))
        plain = svg(ROOM, 'width="4000" viewBox="0 0 4000 3000"')
        assert read_svg(tmp_path, plain, metres_per_unit=0.002).size == pytest.approx((8.0, 6.0))
        with pytest.raises(ValueError, match=r"^[^\n]*plan\.svg: .* --metres-per-unit 0\.001"):
            read_svg(tmp_path, plain)

    def test_a_plan_on_paper_is_asked_for_its_unit(self, tmp_path):
        paper = svg(ROOM, 'width="297mm" viewBox="0 0 4000 3000"')
        with pytest.raises(ValueError, match=r"walls measure 0\.297 x 0\.223 m: give the length"):
            read_svg(tmp_path, paper)
        assert read_svg(tmp_path, paper, metres_per_unit=0.0003).size == pytest.approx((1.2, 0.9))

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("", "not SVG"),
            ("<html/>", "another kind of XML"),
            (svg(""), "no lines that are walls"),
            (svg("<line x2='4000'/>"), "on one line"),
            (svg("<path d='M0 0L5'/>"), "path '' cannot be read"),
            (svg("<path d='Z'/>"), "a path begins with M"),
            (svg("<line x2='far'/>"), "'far' is no length"),
            (svg("<g transform='turn(3)'><line x2='4'/></g>"), "no transformation"),
            (svg("<path d='M0 0L1e999 5'/>"), "number that is too large"),
            (svg("<path d='M0 0C1e300 1 2 1e300 5 5'/>"), "number that is too large"),
            (svg("<g id='a'><use href='#a'/></g>"), "more than 60 deep"),
            (svg("<path d='M0 0" + "h1v1" * 600_000 + "'/>"), "more than 100000 lines"),
            (svg(ROOM, 'width="far mm"'), "is no length"),
        ],
        ids=lambda value: value[-25:],
    )
    def test_what_is_no_plan_is_refused_in_one_line(self, tmp_path, text, reason):
        with pytest.raises(ValueError, match=rf"^[^\n]*plan\.svg: [^\n]*{reason}[^\n]*$"):
            read_svg(tmp_path, text)

    def test_a_few_lines_that_stand_for_billions_are_refused(self, tmp_path, monkeypatch):
        monkeypatch.setattr(svg_module, "MAX_ELEMENTS", 3000)
        groups = [f"<g id='g{n}'>" + f"<use href='#g{n - 1}'/>" * 10 + "</g>" for n in range(1, 11)]
        with pytest.raises(ValueError, match="more than 3000 elements"):
            read_svg(tmp_path, svg("<g id='g0'><line x2='9'/></g>" + "".join(groups)))


def drawing(unit: int, scale: float, version: str = "R2010"):
    """A flat of 6 x 4 m whose unit is 1 / ``scale`` m, far from the origin."""
    document = ezdxf.new(version)
    document.units = unit
    space = document.modelspace()

    def at(x, y):
        return (1000.0 + x) * scale, (y - 2000.0) * scale

    def add(layer, *points):
        for first, second in itertools.pairwise(points):
            space.add_line(at(*first), at(*second), dxfattribs={"layer": layer})

    layer = {"layer": "A-WALL-FULL"}
    space.add_lwpolyline(
        [at(6, 2), at(6, 4), at(0, 4), at(0, 0), at(6, 0), at(6, 1)], dxfattribs=layer
    )
    add("A-GLAZ", (6, 1), (6, 2))
    add("A-WALL-FULL", (3, 0), (3, 1.5))
    add("A-WALL-FULL", (3, 2.4), (3, 4))
    add("A-DOOR", (3, 1.5), (3, 2.4))
    add("A-DOOR", (3, 1.5), (3.9, 1.5))
    space.add_arc(at(3, 1.5), 0.9 * scale, 0, 90, dxfattribs={"layer": "A-DOOR"})
    add("A-FURN", (1, 3), (2, 3))
    space.add_text("kitchen", dxfattribs={"layer": "A-WALL-FULL"})
    pillar = document.blocks.new("PILLAR")
    pillar.add_lwpolyline([(0, 0), (scale, 0), (scale, scale), (0, scale)], close=True)
    space.add_blockref("PILLAR", at(4, 2), dxfattribs={**layer, "xscale": 0.3, "yscale": 0.5})
    return document


FLAT = (
    ends([[6, 2, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [0, 0, 6, 0], [6, 0, 6, 1], [6, 1, 6, 2]])
    | ends([[3, 0, 3, 1.5], [3, 2.4, 3, 4]])
    | box(4, 2, 4.3, 2.5)
)


def read_dxf(folder, document, **arguments) -> World:
    path = folder / "plan.dxf"
    document.saveas(path)
    return load_world(path, **arguments)


class TestDxf:
    @pytest.mark.parametrize(
        ("unit", "scale"),
        [(4, 1000.0), (5, 100.0), (6, 1.0), (1, 1 / 0.0254), (2, 1 / 0.3048)],
        ids=["mm", "cm", "m", "inch", "foot"],
    )
    def test_layers_of_walls_and_windows_are_walls_in_any_unit(self, tmp_path, unit, scale):
        world = read_dxf(tmp_path, drawing(unit, scale))
        assert world.size == (pytest.approx(6.0), pytest.approx(4.0))
        assert ends(world.walls) == FLAT
        assert ends(world.doors) == ends([[3, 1.5, 3, 2.4]])
        assert world.notes == ("layers that are not used: A-FURN",)
        world.check(RADIUS)

    def test_a_drawing_without_a_unit_is_asked_for_it(self, tmp_path):
        document = drawing(0, 50.0)
        with pytest.raises(ValueError, match=r"plan\.dxf: .* --metres-per-unit 0\.001"):
            read_dxf(tmp_path, document)
        assert ends(read_dxf(tmp_path, document, metres_per_unit=0.02).walls) == FLAT

    def test_a_wrong_unit_is_named_by_the_size_that_it_gives(self, tmp_path):
        with pytest.raises(ValueError, match=r"measure 6e\+03 x 4e\+03 m: give the length of its"):
            read_dxf(tmp_path, drawing(6, 1000.0))

    def test_without_names_of_walls_all_lines_but_those_of_doors_are_walls(self, tmp_path):
        document = ezdxf.new()
        document.units = 6
        space = document.modelspace()
        for number, (x1, y1, x2, y2) in enumerate(ROOM_LINES):
            space.add_line((x1, y1), (x2, y2), dxfattribs={"layer": f"L{number % 2}"})
        space.add_line((1, 1), (2, 2), dxfattribs={"layer": "Doors"})
        hidden = document.layers.add("Hidden")
        hidden.off()
        space.add_line((1, 2), (2, 2), dxfattribs={"layer": "Hidden"})
        world = read_dxf(tmp_path, document)
        assert ends(world.walls) == box(0, 0, 4, 3)
        assert world.notes == (
            "no layer is called walls, so all lines are walls; layers: L0, L1; --layers chooses",
        )
        assert len(read_dxf(tmp_path, document, layers=["L0", "doors"]).walls) == 3

    def test_curves_of_every_kind_are_walls(self, tmp_path):
        document = ezdxf.new()
        document.units = 6
        space = document.modelspace()
        space.add_circle((0, 0), 3)
        space.add_ellipse((0, 0), (2, 0), 0.5)
        space.add_spline([(-1, 0), (0, 0.5), (1, 0)])
        space.add_polyline2d([(0, -0.5, 1.0), (0.5, -0.5, 1.0)], format="xyb", close=True)
        space.add_mline([(-0.5, -1.5), (0.5, -1.5)])
        world = read_dxf(tmp_path, document)
        assert world.size == (pytest.approx(6.0), pytest.approx(6.0))
        # The two lines of a multiline are 1 apart, the upper one through its points.
        assert ends([[2.5, 1.5, 3.5, 1.5], [2.5, 0.5, 3.5, 0.5]]) <= ends(world.walls)
        radii = np.hypot(*(world.walls[:, :2] - 3.0).T)
        assert len(world.walls) > 60
        assert radii.max() == pytest.approx(3.0, abs=0.002)
        # The bulges make a circle of 0.25 m around (0.25, -0.5).
        assert (
            np.isclose(np.hypot(*(world.walls[:, :2] - (3.25, 2.5)).T), 0.25, atol=0.002).sum() >= 6
        )

    def test_a_block_in_itself_and_blocks_by_the_million_are_refused(self, tmp_path, monkeypatch):
        monkeypatch.setattr(dxf_module, "MAX_ELEMENTS", 3000)
        document = ezdxf.new()
        document.units = 6
        block = document.blocks.new("B")
        block.add_line((0, 0), (1, 0))
        many = {"row_count": 30000, "column_count": 30000, "row_spacing": 1, "column_spacing": 1}
        document.modelspace().add_blockref("B", (0, 0), dxfattribs=many)
        with pytest.raises(ValueError, match="more than 3000 "):
            read_dxf(tmp_path, document)
        block.add_blockref("B", (1, 1))
        with pytest.raises(ValueError, match="blocks within blocks"):
            read_dxf(tmp_path, document)

    @pytest.mark.parametrize(
        "content", [b"", b"AC1032" + bytes(99), b"0\nSECTION\n2\n", b"0\nLINE"]
    )
    def test_what_is_no_drawing_is_refused_in_one_line(self, tmp_path, content):
        (tmp_path / "plan.dxf").write_bytes(content)
        with pytest.raises(ValueError, match=r"^[^\n]*plan\.dxf: cannot be read: [^\n]+$"):
            load_world(tmp_path / "plan.dxf", metres_per_unit=1.0)

    def test_a_file_of_a_million_lines_is_refused_before_it_is_read(self, tmp_path):
        line = b"0\nLINE\n8\n0\n10\n0.0\n20\n0.0\n11\n1.0\n21\n1.0\n"
        (tmp_path / "plan.dxf").write_bytes(b"0\nSECTION\n2\nENTITIES\n" + line * 600_000)
        with pytest.raises(ValueError, match="larger than 20 MB: save the layers of walls only"):
            load_world(tmp_path / "plan.dxf")


def sketch() -> np.ndarray:
    """An anti-aliased plan of 8 x 6 m, 2 cm a pixel: a room, a wall with a door, a pillar."""
    image = np.full((300, 400, 3), 255, np.uint8)
    cv2.rectangle(image, (20, 20), (380, 280), (0, 0, 0), 6, cv2.LINE_AA)
    cv2.line(image, (200, 20), (200, 120), (40, 20, 60), 6, cv2.LINE_AA)
    cv2.line(image, (200, 165), (200, 280), (40, 20, 60), 6, cv2.LINE_AA)
    cv2.circle(image, (100, 200), 15, (60, 0, 0), -1, cv2.LINE_AA)
    # A light floor of a room is no wall.
    cv2.rectangle(image, (210, 30), (370, 270), (200, 230, 255), -1)
    return image


def coloured(folder, name: str, image: np.ndarray, *options: int):
    path = folder / name
    assert cv2.imwrite(str(path), image, options)
    return path


class TestPictures:
    @pytest.mark.parametrize("name", ["plan.png", "plan.jpg", "plan.JPEG", "plan.bmp", "plan.pgm"])
    def test_dark_pixels_are_walls_in_every_kind_of_picture(self, tmp_path, name):
        image = sketch()
        if name.endswith("pgm"):
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        world = load_world(coloured(tmp_path, name, image), metres_per_pixel=0.02)
        assert world.size == (8.0, 6.0)
        space = world.free_space(RADIUS)
        # Both rooms are one region, through the door; the wall and the pillar are in the way.
        assert space.label_of(np.array([2.0, 4.0])) == space.label_of(np.array([6.0, 3.0])) > 0
        assert space.label_of(np.array([4.0, 1.5])) == 0
        assert space.label_of(np.array([2.0, 2.0])) == 0
        assert space.label_of(np.array([2.0, 2.5])) > 0
        left = np.unique(np.round(world.walls[:, 0], 1))
        assert {0.4, 3.9, 4.0, 4.1} & set(left)
        assert world.notes == ()
        world.check(RADIUS)

    def test_transparent_pixels_are_paper(self, tmp_path):
        grey = cv2.cvtColor(sketch(), cv2.COLOR_BGR2GRAY)
        black = np.dstack((np.zeros((*grey.shape, 3), np.uint8), 255 - grey))
        opaque = load_world(coloured(tmp_path, "grey.png", grey), metres_per_pixel=0.02)
        clear = load_world(coloured(tmp_path, "clear.png", black), metres_per_pixel=0.02)
        np.testing.assert_allclose(clear.walls, opaque.walls)

    @pytest.mark.parametrize("white", [254, 255])
    def test_the_middle_one_of_three_levels_is_unknown(self, tmp_path, white):
        cells = np.full((60, 80), 205, np.uint8)
        cells[10:50, 10:70] = white
        cells[[9, 50], 9:71] = 0
        cells[9:51, [9, 70]] = 0
        cells[20:40, 30:50] = 205
        world = load_world(coloured(tmp_path, "plan.png", cells), metres_per_pixel=0.1)
        space = world.free_space(RADIUS)
        assert space.label_of(np.array([4.0, 3.0])) == 0
        assert space.label_of(np.array([2.0, 3.0])) > 0
        assert world.notes == ("4.0 m^2 within the map are unknown, and are no floor",)

    def test_the_side_of_a_pixel_is_asked_for(self, tmp_path):
        path = coloured(tmp_path, "plan.png", sketch())
        with pytest.raises(ValueError, match=r"plan\.png: .* --metres-per-pixel 0\.02"):
            load_world(path)
        with pytest.raises(ValueError, match=r"plan\.png: metres per pixel must be 0\.001 to 10"):
            load_world(path, metres_per_pixel=0.0)

    def test_a_picture_of_400_million_pixels_is_refused(self, tmp_path):
        Image.new("1", (20_000, 20_000)).save(tmp_path / "plan.png")
        with pytest.raises(ValueError, match=r"plan\.png: more than the 36000000 pixels"):
            load_world(tmp_path / "plan.png", metres_per_pixel=0.01)

    def test_what_is_no_picture_is_refused(self, tmp_path):
        (tmp_path / "plan.jpg").write_bytes(b"GIF89a")
        with pytest.raises(ValueError, match=r"plan\.jpg: cannot be read: it is no JPG file"):
            load_world(tmp_path / "plan.jpg", metres_per_pixel=0.01)


@pytest.mark.parametrize(
    ("source", "arguments", "words"),
    [
        ("env1", {"metres_per_pixel": 0.1}, "env1: 'metres_per_pixel' is for files of .png"),
        ("random:3", {"layers": ["a"]}, "'layers' is for files of .svg, .dxf"),
        ("plan.png", {"metres_per_unit": 0.1}, "'metres_per_unit' is for files of .svg, .dxf"),
        ("plan.svg", {"metres_per_pixel": 0.1}, "plan.svg: 'metres_per_pixel' is for files of"),
    ],
)
def test_an_argument_for_another_kind_of_world_is_refused(source, arguments, words):
    with pytest.raises(ValueError, match=words.replace(".", r"\.")):
        load_world(source, **arguments)


def test_notes_are_no_part_of_a_world(tmp_path):
    world = read_svg(tmp_path, INKSCAPE)
    write_world(world, tmp_path / "plan.toml")
    kept = load_world(tmp_path / "plan.toml")
    assert kept == world
    assert (kept.notes, len(world.notes)) == ((), 1)


def dungeon(path, colours) -> None:
    """A picture of a solid block with a room of 3 x 2 m in it, and a block where robots start, with
    the colours of walls, floor and start.
    """
    pixels = np.full((480, 640, len(np.atleast_1d(colours[0]))), colours[0], dtype=np.uint8)
    pixels[100:200, 300:450] = colours[1]
    pixels[140:156, 340:356] = colours[2]
    Image.fromarray(pixels.squeeze()).save(path)


@pytest.mark.parametrize(
    "colours",
    [(127, 195, 208), ((127, 127, 127, 255), (195, 195, 194, 255), (255, 216, 0, 255))],
)
def test_a_map_of_an_exploration_paper_says_where_robots_start(tmp_path, colours):
    path = tmp_path / "map.png"
    dungeon(path, colours)
    world = load_world(path, metres_per_pixel=0.02)
    np.testing.assert_allclose(world.starts, [[348 * 0.02, (480 - 148) * 0.02, 0.0]])
    world.check(RADIUS)
    region = start_region(world, RADIUS)
    assert region.area == pytest.approx(6.0, abs=0.3)
    assert region.warning is None, "solid walls and the outside are no floor"


def test_the_floor_beside_a_solid_block_is_still_missed(tmp_path):
    path = tmp_path / "map.png"
    dungeon(path, (127, 195, 208))
    pixels = np.array(Image.open(path))
    pixels[20:460, 20:280] = 195
    Image.fromarray(pixels).save(path)
    region = start_region(load_world(path, metres_per_pixel=0.02), RADIUS)
    assert region.share == pytest.approx(6.0 / (6.0 + 440 * 260 * 0.02**2), abs=0.02)
    assert "the other regions cannot be reached" in region.warning
