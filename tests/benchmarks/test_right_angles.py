"""Right angles of a map: two groups of directions, walls out of them, and walls that stand twice."""

import json
import re
import runpy
from importlib.util import find_spec

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.right_angles import right_angles, right_angles_of


def turned(segments, degrees):
    turn = np.radians(degrees)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return (np.array(segments).reshape(-1, 2) @ rotation).reshape(-1, 4)


SQUARE = [[0, 0, 10, 0], [10, 0, 10, 10], [10, 10, 0, 10], [0, 10, 0, 0]]


@pytest.mark.parametrize("degrees", [0.0, 1.0, 44.0, 89.5, -30.0, 179.0])
def test_a_square_has_two_directions_however_it_is_turned(degrees):
    found = right_angles(turned(SQUARE, degrees))
    assert (found.walls, found.in_groups, found.doubled) == (4, 1.0, 0.0)
    assert found.length == pytest.approx(40.0)
    assert found.between == pytest.approx(90.0, abs=1e-6)


def test_a_wall_that_is_bent_is_in_no_group():
    bent = turned([[0, 5, 10, 5]], 5.0)
    found = right_angles(np.vstack((np.array(SQUARE, dtype=float), bent)))
    assert found.in_groups == pytest.approx(0.8)
    assert found.between == pytest.approx(90.0)


def test_walls_that_stand_twice_are_measured():
    found = right_angles(np.array([*SQUARE, [2, 0.5, 6, 0.5], [4, 5, 6, 5]], dtype=float))
    assert found.doubled == pytest.approx(8.0 / 46.0, abs=0.01)


def test_no_walls_are_refused():
    with pytest.raises(ValueError, match="no walls"):
        right_angles(np.zeros((0, 4)))


def test_the_command_prints_a_line_for_each_folder(tmp_path, capsys, monkeypatch):
    (tmp_path / "map.json").write_text(json.dumps({"segments": SQUARE}), encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["benchmarks", "right-angles", str(tmp_path), str(tmp_path / "missing")])
    with pytest.raises(SystemExit) as ended:
        main()
    printed = capsys.readouterr()
    assert "4 walls of 40 m, 100% within 2 deg of two directions 90.0 deg apart" in printed.out
    assert (ended.value.code, printed.err.count("\n")) == (2, 1)
    assert "missing" in printed.err


@pytest.mark.parametrize("content", ["{}", '{"segments": [[1, 2]]}', "{", '{"segments": []}'])
def test_a_map_that_cannot_be_measured_is_named(tmp_path, content):
    (path := tmp_path / "map.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape(f"{path}: ")):
        right_angles_of(tmp_path)


@pytest.mark.parametrize("module", ["right_angles", "revisits", "log_variations"])
def test_a_module_that_was_a_command_names_the_command(module):
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(find_spec(f"benchmarks.{module}").origin), run_name="__main__")
    assert ended.value.code == f"the command is now: python -m benchmarks {module.replace('_', '-')}"


@pytest.mark.parametrize(("error", "ends"), [(KeyboardInterrupt, SystemExit), (ZeroDivisionError, ZeroDivisionError)])
def test_nothing_is_kept_after_ctrl_c_and_a_fault_is_not_hidden(tmp_path, capsys, monkeypatch, error, ends):
    def fails(_):
        raise error

    monkeypatch.setattr("benchmarks.right_angles.right_angles_of", fails)
    monkeypatch.setattr("benchmarks.__main__.signal.signal", lambda *_: None)
    monkeypatch.setattr("sys.argv", ["benchmarks", "right-angles", str(tmp_path)])
    with pytest.raises(ends):
        main()
    assert capsys.readouterr().err == ("benchmarks: stopped\n" if error is KeyboardInterrupt else "")
