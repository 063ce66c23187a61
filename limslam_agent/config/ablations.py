"""Parts of the method that can be left out, to see what they are worth."""

from dataclasses import replace

from limslam_agent.config.presets import AgentConfig

NO_GATE = 1e6
"""A gap, m, that no end points have. A finite one, since settings are written as JSON."""

ABLATIONS = ("no-ekf", "no-loop-closing", "no-end-gate", "only-best-line")


def ablated(config: AgentConfig, ablation: str) -> AgentConfig:
    """Settings with one part of the method left out.

    Raises
    ------
    ValueError
        If there is no such part, or the estimator has no such part.
    """
    if config.estimator != "published" and ablation in set(ABLATIONS) - {"no-loop-closing"}:
        raise ValueError(f"{ablation} leaves out a part of the published method: it goes with the preset paper")
    if ablation == "no-ekf":
        return replace(config, filter=replace(config.filter, correct=False))
    if ablation == "no-loop-closing":
        return replace(config, closing=replace(config.closing, enabled=False))
    if ablation == "no-end-gate":
        return replace(config, association=replace(config.association, max_end_gap=NO_GATE))
    if ablation == "only-best-line":
        return replace(config, hough=replace(config.hough, only_best=True))
    raise ValueError(f"no ablation is called {ablation!r}; there are {', '.join(ABLATIONS)}")
