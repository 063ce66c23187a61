"""The method of O. Ozisik and S. Yavuz, "Simultaneous localization and mapping with limited sensing
using extended Kalman filter and Hough transform", 2016, with its sections and equations.

Read ``features`` (section 2.2), ``filter`` (2.4, eq. 1 to 3), ``association`` (eq. 4), ``slam``:
the step, and loop closing (2.5). Numbers that the paper does not give are settings.
"""

from limslam_agent.slam.published.association import (
    Associate,
    Innovation,
    Landmarks,
    Match,
    PaperAssociation,
)
from limslam_agent.slam.published.features import ObservedLine
from limslam_agent.slam.published.slam import PublishedSlam

__all__ = [
    "Associate",
    "Innovation",
    "Landmarks",
    "Match",
    "ObservedLine",
    "PaperAssociation",
    "PublishedSlam",
]
