"""The tutorials as notebooks, and what a notebook shows."""

import json
import tomllib

import numpy as np
import pytest
from support.command_line import refused, told
from support.markdown import ROOT, blocks

from limslam_agent import Mapper, command, read_log, read_run, write_drives
from limslam_agent.notebooks import folder_of_pages, notebook_pages
from limslam_env import RobotSpec, load_world

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("course") / "notebooks"
    told("notebooks", folder)
    return {path.stem: json.loads(path.read_text()) for path in folder.glob("*.ipynb")}


def cells(notebook, kind):
    return [cell["source"] for cell in notebook["cells"] if cell["cell_type"] == kind]


def test_each_page_becomes_a_notebook_with_its_cells(written):
    assert set(written) == {page.stem for page in notebook_pages()} >= {"method", "lab", "own_log"}
    for page in notebook_pages():
        source = ROOT / "docs" / page.relative_to(folder_of_pages())
        own = [
            block.text.strip() for block in blocks(source) if block.language == "{code-cell} python"
        ]
        assert len(own) > 1
        assert cells(written[page.stem], "code")[1:] == own


def test_its_cells_are_plain_python_that_needs_no_shell(written):
    for name, notebook in written.items():
        first, *own = cells(notebook, "code")
        assert "pip" in first
        for number, code in enumerate(own):
            compile(code, f"{name}, cell {number}", "exec")
            assert "subprocess" not in code
            assert "get_ipython" not in code


def test_its_prose_has_no_links_that_lead_nowhere_and_formulas_that_jupyter_shows(written):
    prose = "\n".join(text for notebook in written.values() for text in cells(notebook, "markdown"))
    assert ".md)" not in prose
    assert "](what_goes_wrong.ipynb)" in prose
    assert "![" not in prose
    assert "```math" not in prose
    assert "code-cell" not in prose


def test_a_notebook_that_is_there_is_kept(tmp_path):
    (tmp_path / "method.ipynb").write_text("mine")
    assert "method.ipynb: is there already; --force replaces it" in refused("notebooks", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["method.ipynb"]
    told("notebooks", tmp_path, "--force")
    assert "nbformat" in (tmp_path / "method.ipynb").read_text()


def test_the_wheel_has_each_page():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    target = project["tool"]["hatch"]["build"]["targets"]
    docs = folder_of_pages()
    pages = {page.relative_to(docs).as_posix() for page in notebook_pages()} | {"drives"}
    included = {f"docs/{name}": f"limslam_agent/pages/{name}" for name in pages}
    assert target["wheel"]["force-include"] == included


def test_a_command_runs_in_python_and_is_refused_with_a_reason(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command("run --max-time 2 --preset odometry --out 'a run'")
    run = read_run("a run")
    assert f"results     {run.folder}" in capsys.readouterr().out
    assert run.metrics["path_m"] < 0.5 < run.time[-1]
    assert run._repr_png_().startswith(PNG)
    with pytest.raises(ValueError, match="--force replaces them"):
        command("run --max-time 2 --preset odometry --out 'a run'")
    with pytest.raises(ValueError, match="No such command"):
        command("walk")


def test_worlds_maps_and_beliefs_show_themselves():
    mapper = Mapper(RobotSpec())
    mapper.step({"ranges": np.full(6, 1.0), "wheels": np.array([0.02, 0.02])})
    for shown in (load_world("env1"), mapper.snapshot(), mapper.belief):
        assert shown._repr_png_().startswith(PNG)


def test_the_drives_have_their_worlds(tmp_path):
    write_drives(tmp_path)
    for name in ("env1", "square"):
        log = read_log(tmp_path / name / "log.npz")
        world = load_world(tmp_path / name / "world.toml")
        world.check_poses(log.true_pose[::100], log.robot.radius * 0.9)
        assert world.name == name
