"""Entries of the arena, and results that were made up."""

import json
from dataclasses import asdict, replace

from limslam_agent.arena.entry import read_entry
from limslam_agent.arena.results import STAMP, Row, digest_of, stamp_of
from limslam_agent.arena.scoring import ENOUGH, loss
from limslam_agent.arena.tracks import plans_of
from limslam_agent.measurements.store import RESULTS

MANIFEST = """
name = "{name}"
authors = ["A. Person"]
kind = "shipped"
run = "random"
uses = "belief"
robots = 2
"""


def short_plans():
    """Plans of two seconds."""
    return [replace(plan, max_time=2.0) for plan in plans_of()[:3]]


def made_entry(folder, manifest, **files):
    folder.mkdir(parents=True)
    (folder / "entry.toml").write_text(manifest)
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    return read_entry(folder)


def made_results(folder, entry, times, *, seed=0, claims=()):
    """A folder of results with a time to 95 % of each plan, where the longest time is a lost
    plan.
    """
    plans = plans_of(seed)
    stamp = stamp_of(entry, seed, versions={"limslam": "0"}, commit="0" * 40)
    folder.mkdir(parents=True)
    (folder / STAMP).write_text(json.dumps(asdict(stamp)))
    lines = []
    for plan, time in times.items():
        lost = time >= plans[plan].max_time
        claims_done = plan in claims or not lost
        metrics = {
            "plan_time_to_95_s": time,
            "plan_time_to_80_s": time if lost else 0.5 * time,
            "time_to_80_s": 0.5 * time,
            "time_to_95_s": time,
            "end_time_s": time,
            "since_new_s": 0.0,
            "correct_coverage": 0.9 if lost else max(ENOUGH, 0.99),
            "ate_final_m": 0.02,
            "wall_f1_5cm": 0.9,
            "anees_final": None,
            "touches": 0,
            "claims_done": claims_done,
            "lost": loss(0.9, is_finished=claims_done) if lost else "",
        }
        settings = digest_of({"plan": plans[plan].setting, "entry": entry.digest})
        row = Row(
            plan,
            plans[plan].setting,
            metrics,
            {"cpu_s": 2.0},
            stamp.versions,
            stamp.commit,
            settings,
        )
        lines.append(json.dumps(asdict(row)))
    (folder / RESULTS).write_text("\n".join(lines) + "\n")
    return folder
