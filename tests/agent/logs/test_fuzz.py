"""Mutated inputs of every format: each reader reads them or refuses them in one short line
(tests/support/fuzz.py).
"""

import pytest
from support.fuzz import fuzz, targets

COUNT = 300
LONG_COUNT = 10_000


@pytest.mark.parametrize("target", targets(), ids=lambda target: target.name)
def test_the_unchanged_inputs_are_read(target, tmp_path):
    for name, content in target.files.items():
        (tmp_path / name).write_bytes(content)
    target.read(tmp_path / target.mutated)


def test_mutated_inputs_are_read_or_refused_in_one_line():
    assert not fuzz(COUNT, 1)


@pytest.mark.slow
def test_many_mutated_inputs_are_read_or_refused_in_one_line():
    assert not fuzz(LONG_COUNT, 2)
