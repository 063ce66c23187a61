"""LimSLAM's agent: line-landmark EKF-SLAM and frontier exploration with a few range beams.

The names in ``__all__`` are the public interface of this package. All other names are private and
may change in any release. A public name is imported when it is first used, so that ``import
limslam_agent`` stays fast.

The agent cannot see the truth: except for ``evaluate`` and ``command``, which run the simulator,
nothing here imports more of ``limslam_env`` than its geometry and its interface. The agent
therefore also runs on a robot.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from limslam_agent.belief import Belief as Belief
    from limslam_agent.cli.command import command as command
    from limslam_agent.config.presets import AgentConfig as AgentConfig
    from limslam_agent.config.presets import preset as preset
    from limslam_agent.config.presets import with_until as with_until
    from limslam_agent.logs.log_reader import read_log as read_log
    from limslam_agent.mapping.mapper import Mapper as Mapper
    from limslam_agent.mapping.mapper import MapSnapshot as MapSnapshot
    from limslam_agent.mapping.team import LimSlamAgent as LimSlamAgent
    from limslam_agent.mapping.team import LimSlamTeam as LimSlamTeam
    from limslam_agent.notebooks import write_drives as write_drives
    from limslam_agent.output.export import save_map as save_map
    from limslam_agent.output.finished_run import read_run as read_run
    from limslam_agent.policies.frontier_policy import FrontierPolicy as FrontierPolicy
    from limslam_agent.policies.learned.learned import LearnedPolicy as LearnedPolicy
    from limslam_agent.policies.policy import Policy as Policy
    from limslam_agent.policies.simple_policies import Laps as Laps
    from limslam_agent.policies.simple_policies import RandomPolicy as RandomPolicy
    from limslam_agent.policies.simple_policies import WallFollower as WallFollower
    from limslam_agent.policies.target_policy import TargetPolicy as TargetPolicy
    from limslam_agent.replay.replay import replay_log as replay_log
    from limslam_agent.runs.evaluate import evaluate as evaluate
    from limslam_agent.runs.evaluate import medians as medians
    from limslam_agent.slam.batch.batch_slam import BatchSlam as BatchSlam
    from limslam_agent.slam.slam import LineSlam as LineSlam
    from limslam_agent.wrappers.single import SlamObservation as SlamObservation
    from limslam_agent.wrappers.vector import SlamVectorObservation as SlamVectorObservation

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
    "TargetPolicy": "policies.target_policy",
    "WallFollower": "policies.simple_policies",
    "command": "cli.command",
    "evaluate": "runs.evaluate",
    "medians": "runs.evaluate",
    "preset": "config.presets",
    "read_log": "logs.log_reader",
    "read_run": "output.finished_run",
    "replay_log": "replay.replay",
    "save_map": "output.export",
    "with_until": "config.presets",
    "write_drives": "notebooks",
}

__all__ = list(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    import importlib

    if name == "__version__":  # both packages are one distribution
        return importlib.import_module("limslam_env").__version__
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
