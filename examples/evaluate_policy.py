"""Scores a function beside the frontier explorer: ``python examples/evaluate_policy.py``."""

from limslam_agent import LimSlamAgent, evaluate, medians, preset
from limslam_env import NominalNoise, Observation, RobotSpec

ENV = "LimSlam-Env1-v0"


def bounce(observation: Observation) -> tuple[float, float]:
    """Wheel speeds: ahead, or a turn to the right if one of the four beams ahead is short."""
    return (0.6, -0.5) if observation["ranges"][1:5].min() < 0.35 else (0.7, 0.7)


explorer = LimSlamAgent(RobotSpec(), preset("consistent", NominalNoise(range_std=0.02)))
for name, actor in {"bounce": bounce, "frontier": explorer}.items():
    scores = medians(evaluate(actor, ENV, range(2), max_time=90.0, sensor_noise=0.02))
    coverage = scores["coverage_true"]
    touches = scores["collisions"]
    print(f"{name:8}  coverage {coverage:.3f}  collisions {touches:.0f}")
