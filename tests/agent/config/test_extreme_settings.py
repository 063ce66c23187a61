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
