"""LimSLAM's agent: line-landmark EKF-SLAM and frontier exploration with a few range beams.

The names in ``__all__`` are the public interface of this package. All other names are private and may change in any
release. A public name is imported when it is first used, so that ``import limslam_agent`` stays fast.

The agent cannot see the truth: except for ``evaluate``, which runs the simulator to score agents, nothing here imports
more of ``limslam_env`` than its geometry and its interface. The agent therefore also runs on a robot.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from limslam_agent.belief import Belief
    from limslam_agent.config.presets import AgentConfig, preset, with_until
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.mapping.mapper import Mapper, MapSnapshot
    from limslam_agent.mapping.team import LimSlamAgent, LimSlamTeam
    from limslam_agent.output.live_map import save_map
    from limslam_agent.policies.frontier_policy import FrontierPolicy
    from limslam_agent.policies.learned.learned import LearnedPolicy
    from limslam_agent.policies.policy import Policy
    from limslam_agent.policies.simple_policies import Laps, RandomPolicy, WallFollower
    from limslam_agent.replay.replay import replay_log
    from limslam_agent.runs.evaluate import evaluate, medians
    from limslam_agent.slam.batch.batch_slam import BatchSlam
    from limslam_agent.slam.slam import LineSlam
    from limslam_agent.wrappers.single import SlamObservation
    from limslam_agent.wrappers.vector import SlamVectorObservation

__all__ = [
    "AgentConfig",
    "BatchSlam",
    "Belief",
    "FrontierPolicy",
    "Laps",
    "LearnedPolicy",
    "LimSlamAgent",
    "LimSlamTeam",
    "LineSlam",
    "MapSnapshot",
    "Mapper",
    "Policy",
    "RandomPolicy",
    "SlamObservation",
    "SlamVectorObservation",
    "WallFollower",
    "evaluate",
    "medians",
    "preset",
    "read_log",
    "replay_log",
    "save_map",
    "with_until",
]

_MODULES = {
    "AgentConfig": "config.presets",
    "BatchSlam": "slam.batch.batch_slam",
    "Belief": "belief",
    "FrontierPolicy": "policies.frontier_policy",
    "Laps": "policies.simple_policies",
    "LearnedPolicy": "policies.learned.learned",
    "LimSlamAgent": "mapping.team",
    "LimSlamTeam": "mapping.team",
    "LineSlam": "slam.slam",
    "MapSnapshot": "mapping.mapper",
    "Mapper": "mapping.mapper",
    "Policy": "policies.policy",
    "RandomPolicy": "policies.simple_policies",
    "SlamObservation": "wrappers.single",
    "SlamVectorObservation": "wrappers.vector",
    "WallFollower": "policies.simple_policies",
    "evaluate": "runs.evaluate",
    "medians": "runs.evaluate",
    "preset": "config.presets",
    "read_log": "logs.log_reader",
    "replay_log": "replay.replay",
    "save_map": "output.live_map",
    "with_until": "config.presets",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    import importlib

    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
