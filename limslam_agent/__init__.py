"""LimSLAM's mind: line-landmark EKF-SLAM and frontier exploration from a few range beams.

Nothing that acts in here can see the truth: of the world's package an agent imports geometry and the
interface, so it also runs on a robot. ``evaluate`` scores agents, and needs the simulator. All is loaded when it is
first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from limslam_agent.agent import LimSlamAgent
    from limslam_agent.config.presets import AgentConfig, preset
    from limslam_agent.runs.evaluate import evaluate, medians
    from limslam_agent.slam.slam import LineSlam
    from limslam_agent.team import LimSlamTeam

__all__ = ["AgentConfig", "LimSlamAgent", "LimSlamTeam", "LineSlam", "evaluate", "medians", "preset"]

_HOMES = {
    "LimSlamAgent": "agent",
    "LimSlamTeam": "team",
    "AgentConfig": "config.presets",
    "preset": "config.presets",
    "LineSlam": "slam.slam",
    "evaluate": "runs.evaluate",
    "medians": "runs.evaluate",
}


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used."""
    import importlib

    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
