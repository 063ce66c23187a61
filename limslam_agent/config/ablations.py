"""Ablations: settings with one part of the method switched off, which shows what that part contributes."""

from collections.abc import Callable
from dataclasses import replace

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig, EstimatorConfig
from limslam_agent.config.published import PublishedConfig

NO_GATE = 1e6
"""A gap that is longer than any gap between end points, m. It is finite, since settings are written as JSON."""


def _without_loop_closing(config: ConsistentConfig) -> ConsistentConfig:
    return replace(config, merging=replace(config.merging, enabled=False))


_PUBLISHED: dict[str, Callable[[PublishedConfig], PublishedConfig]] = {
    "no-ekf": lambda config: replace(config, filter=replace(config.filter, correct=False)),
    "no-loop-closing": lambda config: replace(config, closing=replace(config.closing, enabled=False)),
    "no-end-gate": lambda config: replace(config, association=replace(config.association, max_end_gap=NO_GATE)),
    "only-best-line": lambda config: replace(config, hough=replace(config.hough, only_best=True)),
}

ABLATIONS = tuple(_PUBLISHED)


def ablated(config: AgentConfig, ablation: str) -> AgentConfig:
    """Settings with one part of the method switched off.

    Raises
    ------
    ValueError
        If there is no such ablation, or the estimator has no such part.
    """
    if ablation not in ABLATIONS:
        raise ValueError(f"no ablation is called {ablation!r}; there are {', '.join(ABLATIONS)}")
    return replace(config, estimator=_ablated(config.estimator, ablation))


def _ablated(estimator: EstimatorConfig, ablation: str) -> EstimatorConfig:
    if isinstance(estimator, PublishedConfig):
        return _PUBLISHED[ablation](estimator)
    if ablation == "no-loop-closing":
        return _without_loop_closing(estimator)
    raise ValueError(f"{ablation} switches off a part of the published method: it needs the preset paper")
