"""Figures: which there are, what they show, and that drawing them leaves nothing behind."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from PIL import Image
from support.benchmark_rows import failed, grid, row, series_of, write_folder

from benchmarks.analysis.figure_style import chosen, file_word, headline, legend_below, uneven_sheet
from benchmarks.analysis.groups import groups
from benchmarks.analysis.map_figures import median_run
from benchmarks.analysis.plots import drawings, plot
from benchmarks.suite.store import read_rows


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    rows = grid(seeds=3)
    rows += [row("square", 0.02, seed, laps=4) for seed in range(3)]
    rows += [row("env1", 0.02, seed, ablation="no-ekf", ate_m=0.5) for seed in range(3)]
    rows += [row(f"random:{plan}", 0.02) for plan in range(2)] + [failed(row(seed=7))]
    return write_folder(tmp_path_factory.mktemp("results") / "run", rows)


@pytest.fixture(scope="module")
def found(folder):
    return {drawing.name: drawing for drawing in drawings(read_rows(folder), folder)}


def test_the_figures_of_the_paper_are_there(found):
    assert set(found) == {
        "maps_1_robot", "maps_2_robots", "maps_random_20mm_1", "errors_square_20mm", "noise_1_robot",
        "noise_2_robots", "coverage", "methods",
    }  # fmt: skip


def test_each_figure_says_what_is_to_be_seen(found):
    for drawing in found.values():
        assert len(drawing.alt) > len(drawing.title) > 20
        assert "\n" not in drawing.alt


@pytest.mark.parametrize(("laps", "words"), [(1, "over 1 lap of"), (2, "over 2 laps of")])
def test_the_end_of_a_lap_is_in_the_legend_where_it_is_drawn(tmp_path, laps, words):
    rows = [row("square", 0.02, seed, laps=laps) for seed in range(2)]
    run = write_folder(tmp_path / "run", rows)
    (drawing,) = [each for each in drawings(read_rows(run), run) if each.name.startswith("errors_")]
    assert words in drawing.title
    (legend,) = drawing.figure.legends
    assert ("end of a lap" in [text.get_text() for text in legend.get_texts()]) == (laps > 1)


def test_maps_show_the_run_with_the_median_f1(found):
    rows = [each for each in grid(seeds=3) if (each.world, each.noise, each.robots) == ("env1", 0.0, 1)]
    middle = sorted(rows, key=lambda each: each.metrics["wall_f1"])[1]
    titles = [axes.get_title() for axes in found["maps_1_robot"].figure.axes]
    assert titles[0] == f"env1, 0 cm: seed {middle.seed}, F1 {middle.metrics['wall_f1']:.2f} (median of 3)"
    assert len(titles) == 4


def test_of_an_even_number_the_lower_median_is_shown():
    rows = [replace(row(seed=seed, wall_f1=score), series="x") for seed, score in enumerate((0.1, 0.9, 0.4, 0.6))]
    assert median_run(rows)[0].seed == 2
    assert median_run([replace(rows[0], series=None)]) is None


def test_errors_are_drawn_without_and_with_the_filter_on_the_same_scales(found, folder):
    axes = found["errors_square_20mm"].figure.axes
    assert len(axes) == 6
    for left, right in zip(axes[::2], axes[1::2], strict=True):
        assert left.get_ylim() == right.get_ylim()
    thick = max(axes[0].lines, key=lambda line: line.get_linewidth())
    shown = next(each for each in read_rows(folder) if each.laps and f"seed {each.seed} " in found[
        "errors_square_20mm"].title)  # fmt: skip
    series = series_of(shown)
    assert thick.get_ydata() == pytest.approx(series["odometry"][:, 0, 0] - series["true"][:, 0, 0])
    band = axes[1].collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(0.04)


def test_a_sweep_shows_medians_and_bands(found):
    axes = found["noise_1_robot"].figure.axes[0]
    assert [line.get_xdata().tolist() for line in axes.lines] == [[0.0, 2.0]] * 2
    assert len(axes.collections) == 2
    assert {line.get_linestyle() for line in axes.lines} == {"-", "--"}


def test_coverage_goes_on_where_a_run_has_ended(found):
    line = found["coverage"].figure.axes[0].lines[0]
    assert line.get_ydata()[-1] == 1.0
    assert np.all(np.diff(line.get_ydata()) >= 0.0)


def test_methods_are_drawn_at_their_ratio(tmp_path):
    rows = [row(seed=seed, ate_m=0.1) for seed in range(4)]
    rows += [row(seed=seed, ate_m=0.3, ablation="no-ekf") for seed in range(4)]
    drawing = next(each for each in drawings(rows, tmp_path) if each.name == "methods")
    points = [line.get_xdata()[0] for line in drawing.figure.axes[0].lines if line.get_marker() == "D"]
    assert points == pytest.approx([3.0])


def test_plots_are_written_and_legible(folder, tmp_path):
    written = plot(folder, tmp_path / "new" / "plots")
    assert len(written) == 8
    for path in written:
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("L"))
        assert picture.width > 700
        assert pixels[0].min() == pixels[-1].min() == 255
        assert (pixels < 200).mean() > 0.003


def test_the_same_figure_gives_the_same_svg(tmp_path):
    run = write_folder(tmp_path / "run", [row(seed=seed) for seed in range(2)])
    first, second = plot(run, tmp_path / "a", svg=True), plot(run, tmp_path / "b", svg=True)
    assert {path.suffix for path in first} == {".png", ".svg"}
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_drawing_changes_no_setting_and_opens_no_window():
    script = (
        "import io, sys, matplotlib as mpl; before = mpl.rcParams.copy()\n"
        "from support.benchmark_rows import row; from pathlib import Path\n"
        "from benchmarks.analysis.plots import drawings\n"
        "from benchmarks.analysis.figure_style import write_png\n"
        "rows = [row(noise=noise, seed=seed) for noise in (0.0, 0.02) for seed in (0, 1)]\n"
        "for each in drawings(rows, Path('nowhere')): write_png(each, io.BytesIO())\n"
        "assert 'matplotlib.pyplot' not in sys.modules and before == mpl.rcParams.copy()\n"
    )
    paths = "import sys; sys.path[:0] = ['tests', '.']\n"
    subprocess.run([sys.executable, "-c", paths + script], check=True)


def test_no_rows_are_refused_in_one_line(tmp_path):
    (tmp_path / "results.jsonl").write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*no results[^\n]*$"):
        plot(tmp_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_when_all_failed_there_is_nothing_to_draw(tmp_path):
    run = write_folder(tmp_path / "run", [failed(row(seed=seed, laps=laps)) for seed in range(3) for laps in (0, 4)])
    assert plot(run, tmp_path / "out") == []


def test_one_row_is_drawn(tmp_path):
    run = write_folder(tmp_path / "run", [row()])
    assert [path.stem for path in plot(run, tmp_path / "out")] == ["maps_1_robot", "coverage"]


def test_a_log_is_drawn_without_the_truth(tmp_path):
    made = replace(row("log:fr079", policy="replay"), metrics={"relation_error_m": 1.0})
    run = write_folder(tmp_path / "run", [made])
    kept = {name: value for name, value in series_of(made).items()
            if name in {"time", "estimated", "odometry", "segments"}}  # fmt: skip
    np.savez(run / "series" / f"{made.key}.npz", **kept)
    assert [path.stem for path in plot(run, tmp_path / "out")] == ["maps_logs"]


def test_many_worlds_and_noises_are_paged_and_thinned(tmp_path):
    rows = [row(f"w{world}", noise / 100) for world in range(5) for noise in range(9)]
    run = write_folder(tmp_path / "run", rows)
    found = {each.name: each for each in drawings(read_rows(run), run)}
    assert {"maps_1_robot_1", "maps_1_robot_2", "coverage_1", "coverage_2", "noise_1_robot"} == set(found)
    assert "3 of 9 noises" in found["maps_1_robot_1"].title
    assert "0 cm" in found["maps_1_robot_2"].alt
    assert "8 cm" in found["maps_1_robot_2"].alt


def test_what_is_chosen_begins_and_ends_with_the_ends():
    assert chosen([1, 2, 3], 3) == [1, 2, 3]
    assert chosen(range(17), 3) == [0, 8, 16]


def test_names_of_files_are_plain():
    assert file_word("plan:KTH, 50/2") == "plan-KTH-50-2"


def test_groups_know_their_failed_runs():
    found = groups([row(), failed(row(seed=1))])
    assert [(len(each.rows), each.failed) for each in found] == [(2, 1)]


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_title_and_legend_of_a_narrow_sheet_lie_within_it(columns):
    figure, _ = uneven_sheet([3.3], columns, 3.3)
    headline(figure, "Maps by one robot, preset consistent: the run with the median F1 of each setting, 3 of 5 noises")
    names = ("walls of the map", "true walls", "believed path", "true path")
    legend_below(figure, [Line2D([], [], label=name) for name in names])
    figure.canvas = FigureCanvasAgg(figure)
    figure.canvas.draw()
    width, height = figure.get_size_inches() * figure.dpi
    for part in (figure.texts, figure.legends):
        assert part
        for artist in part:
            box = artist.get_window_extent()
            assert box.x0 >= 0.0
            assert box.x1 <= width
            assert box.y1 <= height
