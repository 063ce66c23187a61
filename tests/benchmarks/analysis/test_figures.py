"""Figures and the report: which there are, what they show, and that drawing them leaves nothing behind."""

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from support.benchmark_rows import failed, grid, row, series_of, write_folder

from benchmarks.analysis.figures import drawings, plot
from benchmarks.analysis.report import report
from benchmarks.analysis.style import handle, headline, legend_below, sheet_of
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
    assert set(found) == {"maps", "maps_2_robots", "maps_random_2-cm", "errors_square_2-cm", "noise", "noise_2_robots"}


def test_maps_show_the_run_with_the_median_f1(found):
    rows = [each for each in grid(seeds=3) if (each.world, each.noise, each.robots) == ("env1", 0.0, 1)]
    middle = sorted(rows, key=lambda each: each.metrics["wall_f1"])[1]
    titles = [axes.get_title() for axes in found["maps"].figure.axes]
    assert titles[0] == f"env1, 0 cm: seed {middle.seed}, F1 {middle.metrics['wall_f1']:.2f} (median of 3)"
    assert len(titles) == 4


def test_errors_are_drawn_without_and_with_the_filter_on_the_same_scales(found, folder):
    axes = found["errors_square_2-cm"].figure.axes
    assert len(axes) == 6
    for left, right in zip(axes[::2], axes[1::2], strict=True):
        assert left.get_ylim() == right.get_ylim()
    thick = max(axes[0].lines, key=lambda line: line.get_linewidth())
    title = found["errors_square_2-cm"].title
    shown = next(each for each in read_rows(folder) if each.laps and f"seed {each.seed} " in title)
    series = series_of(shown)
    assert thick.get_ydata() == pytest.approx(series["odometry"][:, 0, 0] - series["true"][:, 0, 0])
    band = axes[1].collections[0].get_paths()[0].vertices
    assert band[:, 1].max() == pytest.approx(0.04)


def test_a_sweep_shows_medians_and_bands(found):
    axes = found["noise"].figure.axes[0]
    assert [line.get_xdata().tolist() for line in axes.lines] == [[0.0, 2.0]] * 2
    assert len(axes.collections) == 2
    assert {line.get_linestyle() for line in axes.lines} == {"-", "--"}


def test_plots_are_written_and_legible(folder, tmp_path):
    written = plot(folder, tmp_path / "new" / "plots")
    assert len(written) == 6
    for path in written:
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("L"))
        assert picture.width > 700
        assert pixels[0].min() == pixels[-1].min() == 255
        assert (pixels < 200).mean() > 0.003


def test_when_all_failed_or_nothing_ran_there_is_nothing_to_draw(tmp_path):
    run = write_folder(tmp_path / "run", [failed(row(seed=seed, laps=laps)) for seed in range(3) for laps in (0, 4)])
    assert plot(run, tmp_path / "out") == []
    (run / "results.jsonl").write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*no results[^\n]*$"):
        plot(run, tmp_path / "out")


@pytest.mark.parametrize("columns", [1, 3])
def test_title_and_legend_of_a_narrow_sheet_lie_within_it(columns):
    figure, _ = sheet_of([3.3], columns, 3.3)
    headline(figure, "Maps by one robot, preset consistent: the run with the median F1 of each setting, 3 of 5 noises")
    legend_below(figure, list(map(handle, ("walls of the map", "true walls", "believed path", "true path"))))
    figure.canvas = FigureCanvasAgg(figure)
    figure.canvas.draw()
    width, height = figure.get_size_inches() * figure.dpi
    for artist in (*figure.texts, *figure.legends):
        box = artist.get_window_extent()
        assert 0.0 <= box.x0 <= box.x1 <= width
        assert box.y1 <= height


def test_the_report_is_one_page_that_stands_alone(folder, tmp_path):
    assert report(folder, tmp_path / "pages") == tmp_path / "pages" / "report.html"
    text = (tmp_path / "pages" / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|@import|url\(|src=\"(?!data:)", text)
    assert text.count("<img alt=") == 6
    assert text.count("<table>") == text.count("</table>") > 4
    assert "RuntimeError: &lt;boom&gt; &amp; 100% | over_there" in text
    assert f"{len(read_rows(folder))} of {len(read_rows(folder))} runs, commit 0123456789" in text
