# ruff: noqa: INP001
"""Draws ``curves.png`` from the tables that ``examples/rl_batch.py --out`` writes: ``python
docs/images/curves.py "PPO=ppo*.monitor.csv" "recurrent PPO=rec*.monitor.csv"``, run where they are.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

COLOURS = ("#1f6fb4", "#c0392b", "#2e8b57")
MEAN_OF = 64  # episodes, one of each environment
EPISODE = 600  # steps


def main() -> None:
    """Draw the means of all environments, a line for each seed."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained", facecolor="white")
    both = figure.subplots(1, 2)
    for colour, argument in zip(COLOURS, sys.argv[1:], strict=False):
        name, pattern = argument.split("=")
        for number, path in enumerate(sorted(Path().glob(pattern))):
            table = np.genfromtxt(path, delimiter=",", skip_header=2)
            rows = table[: len(table) // MEAN_OF * MEAN_OF].reshape(-1, MEAN_OF, table.shape[1])
            steps = MEAN_OF * EPISODE * np.arange(1, len(rows) + 1) / 1e6
            for axes, column, scale in zip(both, (3, 0), (100.0, 1.0), strict=True):
                label = name if axes is both[0] and not number else None
                values = scale * rows[:, :, column].mean(axis=1)
                axes.plot(steps, values, color=colour, linewidth=1.2, alpha=0.75, label=label)
    both[0].set(ylabel="seen of a plan in a minute, %", ylim=(0.0, 50.0))
    both[1].set(ylabel="reward of an episode", ylim=(0.0, 30.0))
    for axes in both:
        axes.set(xlabel="million steps", xlim=(0.0, None))
        axes.grid(axis="y", color="0.9", linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", frameon=False, ncols=3)
    figure.savefig(Path(__file__).with_name("curves.png"), dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
