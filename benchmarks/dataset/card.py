"""The data card: what a dataset holds, how it was made, its statistics and its known limits."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.dataset.drives import ENVIRONMENT, DatasetConfig
from benchmarks.dataset.minari_files import DESCRIPTIONS, dataset_id
from benchmarks.suite.store import Row

_TEXT = Path(__file__).with_suffix(".md")


def card(config: DatasetConfig, rows: Mapping[str, Sequence[Row]], sizes: Mapping[str, int]) -> str:
    """The text of the card.

    Parameters
    ----------
    config
        Settings of the dataset.
    rows
        Drives of each policy.
    sizes
        Size of the files of each policy, bytes.
    """
    first = next(iter(rows.values()))[0]
    return _TEXT.read_text(encoding="utf-8").format(
        commit=first.commit,
        versions=", ".join(f"{name} {version}" for name, version in first.versions.items()),
        plans=config.plans,
        first=config.first_plan,
        last=config.first_plan + config.plans - 1,
        noise=100.0 * config.noise,
        max_time=config.max_time,
        size=config.size,
        metres=0.1 * config.size,
        sees="24 directions up to 4.3 m",
        environment=ENVIRONMENT,
        policies="\n".join(f"- `{dataset_id(policy)}`: {DESCRIPTIONS[policy]}" for policy in rows),
        table=_table(config, rows, sizes),
        reasons=_reasons(rows),
    )


def _table(config: DatasetConfig, rows: Mapping[str, Sequence[Row]], sizes: Mapping[str, int]) -> str:
    columns = (
        "dataset, episodes, hours, return, steps, coverage at the end, 90 % after (s), contacts, lost (s), MB, kB/plan"
    )
    lines = [f"| {columns.replace(', ', ' | ')} |", "|---|---:|---:|---|---|---|---:|---:|---:|---:|---:|"]
    for policy, driven in rows.items():
        steps = _values(driven, "steps")
        reached = [np.inf if row.metrics["time_to_90_s"] is None else row.metrics["time_to_90_s"] for row in driven]
        middle = float(np.median(np.array(reached, dtype=float)))
        cells = [
            f"`{dataset_id(policy)}`", str(len(driven)), f"{steps.sum() / 36000.0:.2f}",
            _spread(_values(driven, "return"), "{:.1f}"), _spread(steps, "{:.0f}"),
            _spread(_values(driven, "coverage_true"), "{:.2f}"), f"{middle:.0f}" if np.isfinite(middle) else "never",
            f"{_values(driven, 'collisions').sum():.0f}",
            f"{_values(driven, 'lost_s').sum():.0f}", f"{sizes[policy] / 1e6:.1f}",
            f"{sizes[policy] / 1e3 / config.plans:.0f}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _values(rows: Sequence[Row], name: str) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.array([row.metrics[name] for row in rows], dtype=float)


def _spread(values: "np.ndarray[tuple[int], np.dtype[np.float64]]", form: str) -> str:
    middle, low, high = (form.format(float(value)) for value in (np.median(values), values.min(), values.max()))
    return f"{middle} ({low} to {high})"


def _reasons(rows: Mapping[str, Sequence[Row]]) -> str:
    lines = ["Why drives ended:", ""]
    for policy, driven in rows.items():
        counts = Counter(str(row.metrics["stop_reason"]) for row in driven).most_common()
        lines.append(f"- `{policy}`: {'; '.join(f'{reason} ({count})' for reason, count in counts)}")
    return "\n".join(lines)
