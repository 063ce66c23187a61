"""Whether a line that is seen from both sides is a board or the two faces of a wall."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from limslam_agent.slam.line_graph.line_merging import (
    ELSEWHERE,
    LEAST_SHARE,
    PRIOR_LENGTH,
    SURE,
    THICKEST,
    THINNEST,
    board_evidence,
    board_odds,
    is_wall,
)


@pytest.mark.parametrize("behind", [-0.1, 0.0, 0.06, 0.2, 0.4])
@pytest.mark.parametrize("std", [0.02, 0.1, 0.6])
def test_the_evidence_is_the_ratio_of_the_likelihoods(behind: float, std: float) -> None:
    of_walls = quad(lambda thick: norm.pdf(behind, thick, std), THINNEST, THICKEST, points=[behind])[0]
    wanted = norm.pdf(behind, 0.0, std) / (of_walls / (THICKEST - THINNEST) + ELSEWHERE)
    assert board_evidence(behind, std**2) == pytest.approx(math.log(wanted), rel=1e-6, abs=1e-6)


def test_an_exact_offset_decides_and_a_vague_one_does_not() -> None:
    assert board_evidence(0.0, 0.01**2) > SURE
    assert is_wall(board_evidence(0.13, 0.02**2), 0.13)
    assert abs(board_evidence(0.13, 0.5**2)) < 1.0
    # What is in front of a line, or far behind it, is not the other face of its wall.
    assert not is_wall(board_evidence(-0.13, 0.02**2), -0.13)
    assert not is_wall(board_evidence(0.8, 0.02**2), 0.8)


def test_a_building_has_mostly_one_kind_of_walls() -> None:
    vague = board_evidence(0.1, 0.3**2)
    assert board_odds(vague, 10.0, 0.0) > SURE
    assert board_odds(vague, 0.0, 0.0) == pytest.approx(vague)
    assert board_odds(vague, 10.0, 10.0) < SURE
    exact = board_evidence(0.0, 0.01**2)
    assert board_odds(exact, 0.0, 100.0) == pytest.approx(exact + math.log(LEAST_SHARE))
    assert np.isfinite(board_odds(-1e6, 0.0, 1.0 / PRIOR_LENGTH))
