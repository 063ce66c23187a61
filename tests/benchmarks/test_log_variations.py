"""Variations of a log are drives that are possible: relations fit odometry as before."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.log_variations import Variation, variation, varied
from limslam_agent.logs.relations import Relations, relation_errors
from limslam_agent.slam.graph.key_poses import LogData, integrate, to_world
from limslam_env.geometry import se2


@pytest.fixture
def exact():
    """A log with exact odometry, and relations from it."""
    generator = np.random.default_rng(3)
    moves = np.column_stack((np.full(99, 0.1), generator.normal(0.0, 0.01, 99), generator.normal(0.0, 0.2, 99)))
    odometry = integrate(np.zeros(3), moves)
    ranges = generator.uniform(0.5, 3.0, (100, 2))
    time = 0.1 * np.arange(100)
    log = LogData(time, odometry, ranges, ranges < 2.5, np.array([[0.1, 0.02], [0.0, 0.1]]), np.array([1.0, -0.4]), 3.0)
    first, second = np.arange(0, 60), np.arange(30, 90)
    return log, Relations(time[first], time[second], se2.between(odometry[first], odometry[second]))


@pytest.mark.parametrize("how", ["", "mirrored", "backwards", "mirrored backwards"])
def test_exact_odometry_stays_exact(exact, how):
    log, relations = varied(*exact, variation(how))
    errors = relation_errors(relations, log.time, log.odometry, log.odometry)
    assert errors.translation.max() < 1e-9
    assert errors.rotation.max() < 1e-9


@pytest.mark.parametrize("how", ["mirrored", "backwards"])
def test_the_points_are_the_same_in_another_frame(exact, how):
    def shape(log):
        ends = log.origins + log.ranges[..., None] * np.stack((np.cos(log.angles), np.sin(log.angles)), axis=-1)
        points = np.concatenate([to_world(log.odometry, ends[:, beam]) for beam in range(2)])
        return np.sort(np.hypot(*(points - points.mean(axis=0)).T))

    log, _ = exact
    assert np.allclose(shape(varied(*exact, variation(how))[0]), shape(log))


def test_errors_are_added_to_odometry(exact):
    noisy, _ = varied(*exact, variation("range_noise=0.1 odometry_noise=1 seed=4"))
    assert 0.05 < np.std((noisy.ranges - exact[0].ranges)[exact[0].hit]) < 0.15
    assert np.array_equal(noisy.ranges[~exact[0].hit], exact[0].ranges[~exact[0].hit])


def test_settings_are_read():
    how = variation("mirrored beams=90,0,-90 noise=0.05 seed=7")
    assert how == replace(Variation(), mirrored=True, beams=(90.0, 0.0, -90.0), noise=0.05, seed=7)
    with pytest.raises(ValueError, match="loud is no setting"):
        variation("loud=3")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["log.clf", "log.relations", "noise=0.01", "loud=3"], "loud is no setting"),
        (["log.clf"], "relations"),
        (["log.clf", "log.relations"], "log.clf"),
        (["log.csv", "log.relations"], "wheel travel"),
    ],
)
def test_what_cannot_be_varied_is_refused_with_one_line(arguments, said, tmp_path, capsys, monkeypatch):
    (tmp_path / "log.csv").write_text("t,left,right,r_0,r_90\n" + "".join(f"{t},0.01,0.01,1,1\n" for t in range(9)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["benchmarks", "log-variations", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    refused = capsys.readouterr().err
    assert (ended.value.code, refused.count("\n")) == (2, 1)
    assert said in refused
