"""The folder of a session, which has the form of a replayed log."""

from pathlib import Path
from typing import Any

from limslam_agent.live.session import Session
from limslam_agent.output.finished_run import LOG
from limslam_agent.output.summary import record_summary, replay_summary
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.replay.replay import replay_log, write_replay
from limslam_env.messages import counted


def write_session(
    folder: Path, session: Session, title: str, reason: str, prior_map: SavedMap | None
) -> dict[str, Any]:
    """Write log, map, trajectories, picture and result of a session that has ended for a reason,
    into an existing folder. ``prior_map`` is the map of an earlier run in which it began. Returns
    the content of ``result.json``.

    The log is replayed, because lines that came late are in their places in it. What is written is
    therefore what ``limslam replay`` makes of the log.
    """
    session.recording.save(folder / LOG)
    replay = replay_log(session.recording.log(), session.agent.config, prior_map=prior_map)
    scores = {**session.figures, "stop_reason": reason}
    return write_replay(folder, replay, {"log": title}, scores)


def session_lines(result: dict[str, Any]) -> list[str]:
    """A session in a few lines of text, from its ``result.json``."""
    metrics = result["metrics"]
    period = metrics["period_s"]
    delay = metrics["loop_delay_s"]
    times = [
        f"{words} {1e3 * seconds:.0f} ms"
        for words, seconds in (("period", period), ("delay", delay))
        if seconds
    ]
    counts = [
        f"{metrics[name]} {words}"
        for name, words in (
            ("packets_lost", "lost"),
            ("packets_late", "late"),
            ("packets_doubled", "doubled"),
            ("packets_implausible", "implausible"),
            ("lines_bad", "not readable"),
        )
        if metrics[name]
    ]
    events = [
        counted(metrics[name], noun)
        for name, noun in (("reconnections", "reconnection"), ("watchdog_stops", "watchdog stop"))
        if metrics[name]
    ]
    link = ", ".join([counted(metrics["packets"], "line"), *times, *counts, *events])
    return [
        *record_summary(result),
        f"stopped     {metrics['stop_reason']}",
        f"connection  {link}",
        *replay_summary(metrics),
    ]
