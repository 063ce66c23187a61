"""TOML is read with a limit for the parts of keys, wherever a key can stand."""

import pytest

from limslam_env.toml_text import MOST_PARTS, read_toml_text
from limslam_env.worlds.formats.tables import parse_world
from limslam_env.worlds.world import WorldError

LONG = ".".join("a" * (MOST_PARTS + 1))


@pytest.mark.parametrize(
    "text",
    [
        f"{LONG} = 1",
        f"[{LONG}]",
        f"[[{LONG}]]",
        f"x = {{{LONG} = 1}}",
        f"x = [{{{LONG} = 1}}]",
        LONG.replace("a", '"a.b"') + " = 1",
        LONG.replace("a", "'a'") + " = 1",
        LONG.replace(".", " \t. ") + " = 1",
        f'x = """\\""""\n{LONG} = 1',
        f"x = '''\n'''''\n{LONG} = 1",
        f'x = "#"\n{LONG} = 1',
        "a" + ".a" * 400_000 + " = 1",
    ],
)
def test_a_key_of_very_many_parts_is_refused(text):
    with pytest.raises(ValueError, match="a key has more than 10 parts"):
        read_toml_text(text)
    with pytest.raises(WorldError, match=r"mine\.toml: not TOML: a key has more than 10 parts"):
        parse_world(text, "mine.toml")


@pytest.mark.parametrize(
    "text",
    [
        LONG.removesuffix(".a") + " = 1",
        f'x = "{LONG}"',
        f"x = '{LONG}'",
        f'x = """\n{LONG} = 1\n\\""" {LONG} """',
        f"x = '''\n{LONG}\\'''",
        f"x = 1 # {LONG}",
        "x = 1979-05-27T00:32:00.999999\ny = [1.5, 2.5, 3.5]",
        "x = [" + "1.5," * 100_000 + "]",
    ],
)
def test_dots_elsewhere_are_no_parts_of_a_key(text):
    assert read_toml_text(text)


def test_tables_that_are_nested_too_deeply_are_refused():
    with pytest.raises(ValueError, match="nested too deeply"):
        read_toml_text("x = " + "[" * 100_000)
