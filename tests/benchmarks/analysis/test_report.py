"""The report: one page that stands alone, can be read by everyone, and hides no failure."""

import base64
import io
import re
from html.parser import HTMLParser

import pytest
from PIL import Image
from support.benchmark_rows import failed, grid, row, write_folder

from benchmarks.analysis.claims import CLAIMS
from benchmarks.analysis.report import report

VOID = {"meta", "img", "br", "hr", "link", "input", "source"}


class Page(HTMLParser):
    """Elements in order, with a check that each is closed where it should be."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.words = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    def all(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    rows = [*grid(seeds=3, worlds=("env1",)), failed(row(seed=8)), failed(row(seed=9), "worker killed by signal 9")]
    write_folder(folder / "run", rows, jobs=20)
    path = report(folder / "run", folder / "pages" / "page.html")
    assert path == folder / "pages" / "page.html"
    assert [each.name for each in path.parent.iterdir()] == ["page.html"]
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_the_page_is_whole(text, page):
    assert text.startswith("<!DOCTYPE html>")
    assert page.open == []
    assert page.all("html") == [{"lang": "en"}]
    assert [tag for tag, _ in page.elements if tag in {"main", "h1", "title"}] == ["title", "h1", "main"]


def test_nothing_comes_from_elsewhere(text, page):
    assert not re.search(r"https?:|[\"'(=\s]//[a-z]|@import|url\(|src=\"(?!data:)", text)
    assert page.all("link") == []
    assert all("src" not in attrs for attrs in page.all("script"))


def test_each_figure_has_words_and_opens(page):
    images = page.all("img")
    assert len(images) >= 4
    for attrs in images:
        assert len(attrs["alt"]) > 40
        kind, content = attrs["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        with Image.open(io.BytesIO(base64.b64decode(content))) as picture:
            assert picture.width > 500


def test_failures_are_shown_with_their_reasons(page):
    words = " ".join(page.words)
    assert "2 of 14 runs failed" in words
    assert "RuntimeError: <boom> & 100% | over_there" in words
    assert "worker killed by signal 9" in words


def test_the_summary_counts(text):
    tiles = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd>", text))
    assert (tiles["runs"], tiles["failed"], tiles["not run yet"]) == ("14", "2", "6")
    assert tiles["commit"] == "0123456789abcdef"
    assert tiles["numpy"] == "2.0"


def test_links_lead_somewhere_and_a_keyboard_can_follow(page):
    places = {attrs["id"] for _, attrs in page.elements if "id" in attrs}
    links = [attrs["href"] for attrs in page.all("a")]
    assert links[0] == "#summary"
    assert {link.removeprefix("#") for link in links} <= places
    assert len(places) == 6
    boxes = [attrs for tag, attrs in page.elements if tag == "div" and attrs.get("role") == "region"]
    assert len(boxes) >= 5
    assert all(attrs["tabindex"] == "0" and attrs["aria-label"] for attrs in boxes)


def test_tables_have_captions_and_headings_for_columns_and_rows(page):
    assert len(page.all("table")) == len(page.all("caption")) >= 3
    assert {attrs["scope"] for attrs in page.all("th")} == {"col", "row"}


def test_phones_dark_rooms_and_paper_are_thought_of(text, page):
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in page.all("meta")
    for word in (
        "prefers-color-scheme: dark",
        "@media print",
        "break-inside: avoid",
        "focus-visible",
        "overflow-x: auto",
    ):
        assert word in text


def test_the_claims_are_judged_after_the_results(text, page):
    kinds = [attrs["class"] for attrs in page.all("li") if "class" in attrs]
    assert {"refuted", "confirmed"} <= set(kinds)
    assert text.index('<section id="tables">') < text.index('<section id="claims-of-the-paper">')


def test_claims_that_were_not_tried_are_folded_away(text, page):
    (folded,) = [attrs for attrs in page.all("details") if attrs.get("class") == "untried"]
    assert "open" not in folded
    untried = text[text.index('class="untried"') :]
    untried = untried[: untried.index("</details>")]
    kinds = [attrs["class"] for attrs in page.all("li") if "class" in attrs]
    assert untried.count("<li>") == len(CLAIMS) - len(kinds) > 10
    assert "claims were not tried in these rows" in untried


def test_no_figure_is_shown_larger_than_it_was_drawn(page):
    widths = [attrs["style"] for attrs in page.all("img")]
    assert widths
    assert all(re.fullmatch(r"max-width:(\d{3,4})px;min-width:min\(40rem,\1px\)", style) for style in widths)


def test_a_folder_gets_a_file(tmp_path):
    run = write_folder(tmp_path / "run", [failed(row(seed=seed)) for seed in range(2)])
    path = report(run, tmp_path / "out")
    assert path == tmp_path / "out" / "report.html"
    words = Page(path.read_text(encoding="utf-8")).words
    assert "Nothing to draw." in words
    assert "0 (2)" in words


def test_without_a_stamp_there_is_a_report_all_the_same(tmp_path):
    run = write_folder(tmp_path / "run", [row()])
    (run / "suite.json").unlink()
    assert "LimSLAM benchmark: run" in report(run, tmp_path / "r.html").read_text(encoding="utf-8")


def test_no_rows_are_refused_in_one_line(tmp_path):
    (tmp_path / "results.jsonl").write_text("", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*no results[^\n]*$"):
        report(tmp_path, tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()
