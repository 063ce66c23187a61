"""Score a function beside the frontier explorer, by the same metrics: ``python
examples/evaluate_policy.py``.
"""

from limslam_agent import LimSlamAgent, evaluate, medians, preset
from limslam_env import NominalNoise, Observation, RobotSpec


def bounce(observation: Observation) -> tuple[float, float]:
    """Wheel speeds: straight ahead, or a right turn when one of the four beams ahead sees something
    near.
    """
    return (0.6, -0.5) if observation["ranges"][1:5].min() < 0.35 else (0.7, 0.7)


explorer = LimSlamAgent(RobotSpec(), preset("consistent", NominalNoise(range_std=0.02)))
for name, actor in {"bounce": bounce, "frontier": explorer}.items():
    scores = medians(
        evaluate(actor, "LimSlam-Env1-v0", seeds=range(2), max_time=90.0, sensor_noise=0.02)
    )
    print(
        f"{name:8}  coverage {scores['coverage_true']:.3f}  collisions {scores['collisions']:.0f}"
    )
