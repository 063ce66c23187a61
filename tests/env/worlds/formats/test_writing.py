"""Files out: TOML that reads back as the same world."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from limslam_env import World, load_world
from limslam_env.worlds.formats.toml import parse_world, world_toml
from limslam_env.worlds.world import WorldError

BOX = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 1.0], [1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])


def box_world(**changes) -> World:
    return World(**{"name": "box", "size": (1.0, 1.0), "walls": BOX, **changes})


LENGTHS = st.floats(-250.0, 250.0)
ANY = st.floats(allow_nan=False, allow_infinity=False)


def rows(width: int, numbers=LENGTHS, **limits):
    return st.lists(st.tuples(*[numbers] * width), **limits).map(lambda found: np.array(found).reshape(-1, width))


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
    except WorldError:  # nothing that stops a beam, or an edge without length
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
        (tmp_path / "w.toml").write_text(world_toml(world), encoding="utf-8", newline="\n")
        assert load_world(tmp_path / "w.toml") == world

    def test_it_is_written_as_people_write_it(self):
        world = box_world(walls=BOX[:2], obstacles=(np.array([[0.25, 0.25], [0.5, 0.25], [0.5, 1e-7]]),))
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
