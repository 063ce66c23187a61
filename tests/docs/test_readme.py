"""The README does what it says."""

import re
import shlex

from support.markdown import ROOT, blocks, pages, prose

README = ROOT / "README.md"


def texts(language):
    return [block.text for block in blocks(README) if block.language == language]


def test_the_python_example_explores_env1(capsys):
    (block,) = [block for block in blocks(README) if block.language == "python"]
    block.run_python({"__name__": "__main__"})
    share, seconds, walls = re.fullmatch(
        r"(\d+)% seen after (\d+) s, (\d+) walls", capsys.readouterr().out.strip()
    ).groups()
    assert int(share) >= 95
    assert int(seconds) < 600
    assert int(walls) >= 16


def test_the_two_commands_make_all_that_they_need():
    first, second = (text.strip() for text in texts("sh")[:2])
    for command, last in ((first, ".venv/bin/limslam"), (second, ".venv/bin/pytest")):
        steps = [shlex.split(step) for step in command.split("&&")]
        assert steps[0] == ["python3", "-m", "venv", ".venv"]
        assert steps[1][:2] == [".venv/bin/pip", "install"]
        assert steps[2][0] == last


def test_nothing_was_left_to_be_filled_in():
    assert len(pages()) > 3
    # Names of environment variables stand as code.
    text = [re.sub(r"`[^`]*`", "", prose(page)) for page in pages()]
    assert [re.findall(r"\b[A-Z]{3,}_[A-Z0-9]+\b", part) for part in text] == [[]] * len(text)
