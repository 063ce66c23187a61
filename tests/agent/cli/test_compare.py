"""``limslam compare``: finished runs beside each other."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image as Pictures
from support.command_line import invoke

from limslam_agent.cli.show import compare
from limslam_agent.output.export import write_json
from limslam_agent.output.finished_run import read_run
from limslam_agent.output.run_picture import COLOURS, MOST_RUNS, draw_comparison, sheet_size
from limslam_agent.output.tum import write_tum

pytestmark = pytest.mark.usefixtures("no_display")


def write_folder(folder, *, noise=0.02, offset=0.1, truth=True, robots=1, metrics=None):
    folder.mkdir(parents=True)
    time = 0.1 * np.arange(30)
    turns = np.linspace(0.0, 3.0, 30)
    poses = np.column_stack((1.0 + np.cos(turns), 1.0 + np.sin(turns), turns + 1.5))
    for number in range(robots):
        suffix = f"_{number}" if robots > 1 else ""
        write_tum(folder / f"trajectory_est{suffix}.tum", time, poses + offset)
        if truth:
            write_tum(folder / f"trajectory_true{suffix}.tum", time, poses)
    write_json(folder / "map.json", {"segments": [[0.0, 0.0, 4.0, 0.0]], "landmarks": []})
    config = {"world": "hall", "noise": noise, "preset": "paper"}
    write_json(folder / "result.json", {"metrics": metrics or {"ate_m": offset}, "config": config, "seed": 3})
    return folder


def test_metrics_stand_side_by_side_under_what_differs(tmp_path):
    folders = [write_folder(tmp_path / "a", noise=0.0, offset=0.05), write_folder(tmp_path / "b", noise=0.04)]
    told = invoke(compare, *folders, "--out", tmp_path / "both.png").splitlines()
    assert told[0].split("  ")[-1] == "range noise 4 cm"
    assert told[1].split()[-2:] == ["0.05", "0.1"]
    with Pictures.open(tmp_path / "both.png") as picture:
        assert picture.size == tuple(round(150 * side) for side in sheet_size(2))


@pytest.mark.parametrize(("count", "truth", "axes"), [(2, True, 4), (5, True, 7), (3, False, 3)])
def test_each_run_has_a_map_and_errors_are_drawn_where_the_truth_is_known(tmp_path, count, truth, axes):
    runs = [
        read_run(write_folder(tmp_path / str(number), truth=truth, robots=1 + number % 2)) for number in range(count)
    ]
    figure = Figure(figsize=sheet_size(count), layout="constrained")
    draw_comparison(figure, runs, [None] * count)
    assert len(figure.axes) == axes
    if truth:
        # The error of a path that is moved by 0.1 m along x and y, with the colour of each run.
        lines = figure.axes[-2].lines
        assert [line.get_color() for line in lines if line.get_label()[0] != "_"] == list(COLOURS[:count])
        np.testing.assert_allclose(lines[0].get_ydata(), np.hypot(0.1, 0.1), atol=1e-5)


def test_without_a_display_the_way_to_a_picture_is_told(tmp_path):
    folders = [write_folder(tmp_path / name) for name in ("a", "b")]
    assert "--out FILE.png" in invoke(compare, *folders)


def test_refusals(tmp_path):
    folder = write_folder(tmp_path / "a")
    with pytest.raises(ValueError, match="2 to 8 folders"):
        invoke(compare, folder)
    with pytest.raises(ValueError, match=f"not {MOST_RUNS + 1}"):
        invoke(compare, *[folder] * (MOST_RUNS + 1))
    with pytest.raises(ValueError, match="a picture ends in"):
        invoke(compare, folder, folder, "--out", tmp_path / "a.txt")
    with pytest.raises(ValueError, match="no such folder"):
        invoke(compare, folder, tmp_path / "none")
