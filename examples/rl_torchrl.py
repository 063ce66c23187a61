"""LimSLAM in TorchRL: ``python examples/rl_torchrl.py`` (after ``pip install torchrl``; no part of
the extra ``rl``).

`GymEnv` takes the environment without changes. It returns TensorDicts, from which TorchRL's PPO
learns.
"""

import argparse

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import CatTensors, GymEnv, RewardSum, StepCounter, TransformedEnv
from torchrl.envs.transforms import Compose
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import limslam_env  # noqa: F401 (registers the environments)


def main() -> None:
    """Collect rollouts and learn from them in turns."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=100_000)
    options = arguments.parse_args()
    torch.manual_seed(0)
    # The check of each step would only take time here.
    bare = GymEnv(
        "LimSlam-Random-v0", sensor_noise=0.02, max_episode_steps=600, disable_env_checker=True
    )
    one_row = CatTensors(["ranges", "wheels"], out_key="observation", del_keys=False)
    env = TransformedEnv(bare, Compose(one_row, StepCounter(), RewardSum()))
    env.set_seed(0)
    inputs = env.observation_spec["observation"].shape[-1]

    body = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 4), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(body, in_keys=["observation"], out_keys=["loc", "scale"]),
        spec=env.action_spec,
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(
        nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 1)), in_keys=["observation"]
    )
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    objective = ClipPPOLoss(actor, critic)
    optimizer = torch.optim.Adam(objective.parameters(), lr=3e-4)
    done = 0
    while done < options.steps:
        with torch.no_grad():
            rollout = env.rollout(128, actor, break_when_any_done=False)
        advantage(rollout)
        for _ in range(4):
            losses = objective(rollout)
            optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]).backward()
            optimizer.step()
        done += rollout.numel()
        print(f"{done} steps: reward {rollout['next', 'reward'].mean().item():.4f} a step")


if __name__ == "__main__":
    main()
