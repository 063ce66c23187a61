"""Settings with extreme values are refused in one short line, as the fuzzer has found them."""

import pytest

from limslam_agent.cli.settings import Given, RunOptions
from limslam_agent.config.presets import preset


def test_a_whole_number_that_is_no_float_is_refused_with_its_key(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(f"noise = {'9' * 400}\n")
    with pytest.raises(ValueError, match=r"run\.toml: noise: is too large for a number") as caught:
        Given.read(path, {}).merged(RunOptions(), ())
    assert len(str(caught.value)) <= 500


def test_a_very_long_name_of_a_preset_is_cut():
    with pytest.raises(ValueError, match="no preset is called 'xxx") as caught:
        preset("x" * 10_000)
    assert len(str(caught.value)) < 400


def test_a_suite_with_very_many_seeds_is_refused_before_they_are_listed(tmp_path):
    suite = pytest.importorskip("benchmarks.suite.suite")
    path = tmp_path / "some.toml"
    seeds = "seeds = { first = 0, count = 9000000000000 }"
    path.write_text(f'name = "some"\ndescription = "x"\n[[grid]]\nworlds = ["square"]\nnoises = [0.0]\n{seeds}\n')
    with pytest.raises(ValueError, match="a grid has up to 100000 seeds"):
        suite.load_suite(str(path))
