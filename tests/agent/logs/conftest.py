"""Files of logs for the tests of their readers."""

import pytest


@pytest.fixture
def write(tmp_path):
    def _write(*parts, name="some.csv"):
        """A file of texts or bytes, one after the other."""
        path = tmp_path / name
        path.write_bytes(b"".join(p if isinstance(p, bytes) else p.encode() for p in parts))
        return path

    return _write
