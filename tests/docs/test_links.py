"""Links between the pages lead to files and headings that exist, and so do the paths of modules that they name."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.markdown import ROOT, anchors, code_spans, links, name_of, pages

# Only what travels with the tests can be looked for outside of a checkout.
IS_CHECKOUT = (ROOT / "CONTRIBUTING.md").is_file()
TRAVELS = ("docs", "README.md", "examples")


def problem_of(page, target: str) -> str | None:
    """What is wrong with a link of a page; None if it leads somewhere."""
    file, _, anchor = target.partition("#")
    path = (page.parent / file).resolve() if file else page
    inside = path.relative_to(ROOT.resolve()) if path.is_relative_to(ROOT.resolve()) else None
    if inside is None:
        return f"{target}: lies outside of the project"
    if not IS_CHECKOUT and inside.parts[0] not in TRAVELS:
        return None
    if not path.exists():
        return f"{target}: there is no such file"
    if anchor and anchor not in anchors(path):
        return f"{target}: there is no such heading"
    return None


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_links_lead_somewhere(page):
    assert [problem for target in links(page) if (problem := problem_of(page, target))] == []


def test_a_broken_link_would_be_noticed():
    readme = ROOT / "README.md"
    assert "no such file" in problem_of(readme, "docs/nowhere.md")
    assert "no such heading" in problem_of(readme, "docs/metrics.md#nowhere")
    assert "outside" in problem_of(readme, "../elsewhere.md")


def exists(name: str) -> bool:
    """Whether a path such as ``limslam_env/geometry/`` or ``slam/core/ekf.py`` is one of the project's."""
    tops = ("", "limslam_agent", "limslam_env", "limslam_agent/slam", "benchmarks")
    return any((ROOT / top / name).exists() for top in tops)


def importable(name: str) -> bool:
    """Whether a dotted name is a module, or a name within one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = find_spec(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        if found is not None:
            return length >= len(parts) - 2 and (length == len(parts) or has_name(found.name, parts[length]))
    return False


def has_name(module: str, name: str) -> bool:
    """Whether a module defines a name, by its source: importing it may need an extra."""
    path = find_spec(module).origin
    words = rf"^(?:class|def) {name}\b|^{name}\b.*=|\"{name}\"|^\s*{name},?$"
    return re.search(words, Path(path).read_text(encoding="utf-8"), re.MULTILINE) is not None


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_modules_that_a_page_names_exist(page):
    if not IS_CHECKOUT:
        pytest.skip("the sources do not travel with the tests: run them in a checkout")
    paths = {span for span in code_spans(page) if re.fullmatch(r"[a-z_]+/[\w/]*(\.py|/)?", span) and "/" in span}
    paths = {span for span in paths if span.endswith((".py", "/")) and not span.startswith(("runs/", "lists/"))}
    assert {span for span in paths if not exists(span)} == set()
    dotted = {
        span for span in code_spans(page) if re.fullmatch(r"(limslam_env|limslam_agent|benchmarks)(\.\w+)+", span)
    }
    assert {span for span in dotted if not importable(span)} == set()
