"""The lab exercise works as it is written: its commands run one after the other in one folder, on short drives."""

import shutil

import pytest
from support.command_line import limslam
from support.markdown import ROOT, blocks, commands


def test_the_commands_of_the_exercise_run_one_after_the_other(tmp_path):
    page, example = ROOT / "docs" / "lab.md", ROOT / "examples" / "my_policy.py"
    if not example.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    pytest.importorskip("moviepy")
    shutil.copy(example, tmp_path)
    folders = []
    for block in blocks(page):
        if block.language == "toml":
            name = block.text.split()[1]
            (tmp_path / name).write_text(block.text, encoding="utf-8")
            continue
        for words in commands(block.text):
            short = ["--max-time", "8"] if words[1] == "run" else []
            done = limslam(*words[1:], *short, cwd=tmp_path)
            assert done.returncode == 0, f"{words}: {done.stderr}"
            assert done.stderr == "" or words[1] != "replay"
            folders.append(words[words.index("--out") + 1])
    assert len(set(folders)) == len(folders) > 12
    assert all((tmp_path / name).exists() for name in folders)
