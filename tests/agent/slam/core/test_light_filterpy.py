"""filterpy is imported without ``scipy.stats``, and both can be used afterwards as if nothing had been left out."""

import subprocess
import sys

import pytest

USE = """
import filterpy.kalman, filterpy.stats, scipy.stats
from limslam_agent.slam.core.ekf import LineEKF
assert issubclass(LineEKF, filterpy.kalman.ExtendedKalmanFilter)
assert type(scipy.stats.norm).__module__.startswith("scipy.")
for ours, theirs in (
    (filterpy.stats.logpdf(1.0, 0.5, 2.0), scipy.stats.multivariate_normal.logpdf(1.0, 0.5, 2.0)),
    (filterpy.stats.norm.cdf(0.3), scipy.stats.norm.cdf(0.3)),
    (filterpy.stats.norm(1.0, 2.0).cdf(0.3), scipy.stats.norm(1.0, 2.0).cdf(0.3)),
):
    assert ours == theirs
"""
MORE_IS_WANTED = """
import importlib, sys, types
imported = importlib.import_module
def first_with_another_name(name, *arguments):
    if name == "filterpy.kalman" and isinstance(sys.modules.get("scipy.stats"), types.ModuleType):
        from scipy.stats import norm, uniform
    return imported(name, *arguments)
importlib.import_module = first_with_another_name
"""


@pytest.mark.parametrize(
    ("before", "loads"),
    [("", False), ("import scipy.stats", True), ("import filterpy", True), (MORE_IS_WANTED, True)],
    ids=["first", "after scipy.stats", "after filterpy", "another filterpy"],
)
def test_filterpy_works_whatever_was_imported_before(before, loads):
    code = (
        f"{before}\nimport limslam_agent.mapping.mapper, sys\nassert ('scipy.stats' in sys.modules) == {loads}\n{USE}"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
