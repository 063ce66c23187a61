"""Text in TOML that anybody may have written."""

import time

import pytest

from limslam_env.toml_text import parse_toml


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 100_000 + " = 1\n",
        "[a" + ".a" * 100_000 + "]\n",
        "b = {a" + ".a" * 100_000 + " = 1}\n",
        '"=\\"".' * 100_000 + "a = 1\n",
        "1" + ". 1" * 100_000 + " = 1\n",
    ],
)
def test_a_deep_key_is_refused_before_it_is_parsed(text):
    begin = time.process_time()
    with pytest.raises(ValueError, match="line 2: a key has more than 32 dots"):
        parse_toml("name = 'x'\n" + text)
    assert time.process_time() - begin < 10.0


def test_other_dots_are_no_key():
    numbers = ", ".join(["[0.5, 1.5]"] * 100)
    text = f"walls = [{numbers}] # {'.' * 9}\n# {'.' * 80}\nabout = '{'.' * 80}'\na.b.c = 1.25\n"
    assert parse_toml(text)["a"] == {"b": {"c": 1.25}}


def test_brackets_that_are_never_closed_are_refused():
    with pytest.raises(ValueError, match="too many brackets"):
        parse_toml("a = " + "[" * 100_000)
