"""The pages under docs: their examples run, and their tables name what is there."""

import re
from dataclasses import fields
from pathlib import Path

import gymnasium as gym
import pytest

import limslam_env
from limslam_env.config import NoiseConfig
from limslam_env.envs import wrappers

DOCS = Path(__file__).parents[2] / "docs"
ENVIRONMENTS = (DOCS / "environments.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return ENVIRONMENTS.split(f"\n## {title}\n", 1)[1].split("\n## ", 1)[0]


def first_column(text: str) -> set[str]:
    cells = re.findall(r"^\| (`[^|]+) \|", text, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


EXAMPLES = [
    (page, number, example)
    for page in ("environments.md", "batch.md")
    for number, example in enumerate(
        re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL), start=1
    )
]


@pytest.mark.parametrize(("page", "number", "example"), EXAMPLES)
def test_the_examples_run(page, number, example):
    exec(compile(example, f"{page}, example {number}", "exec"), {})  # noqa: S102


def test_every_setting_of_the_noise_is_explained():
    assert first_column(section("Noise")) == {part.name for part in fields(NoiseConfig)}


def test_every_wrapper_is_named():
    assert first_column(section("Wrappers")) - {"limslam_env.envs.wrappers"} == set(wrappers.__all__)


def test_every_id_is_named():
    ids = {name for name in gym.registry if name.startswith("LimSlam-")}
    assert first_column(section("Which there are")) == ids
    assert gym.spec("LimSlam-Random-v0").max_episode_steps == limslam_env.MAX_EPISODE_STEPS


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.name)
def test_links_between_the_pages_lead_somewhere(page):
    links = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
    # What lies outside of docs does not travel with the tests.
    assert [link for link in links if not link.startswith("../") and not (DOCS / link).is_file()] == []
