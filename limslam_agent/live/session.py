"""A session with a live robot: telemetry in, wheel speeds out, until the agent is done or the robot
is gone.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.endings import end_by, noted_endings
from limslam_agent.live.link import POLL, Connection
from limslam_agent.live.orders import HOME, Destination, Goal, Orders
from limslam_agent.live.protocol import (
    Command,
    Heartbeat,
    Hello,
    Message,
    Speeds,
    Stop,
    Telemetry,
    difference,
)
from limslam_agent.live.recording import MM, Recording, Row
from limslam_agent.live.transports import SILENT_AFTER
from limslam_agent.mapping.team import LimSlamAgent
from limslam_agent.policies.policy import Policy, checked_action
from limslam_agent.policies.way_to import WayTo, objection
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

OUT_OF_TIME = "time: the longest time of the session is over"
BY_HAND = "stopped by hand"

HEARTBEAT_AFTER = 1.5
HOLD = 3.0
"""Periods without telemetry after which the host sends heartbeats, and after which it stops the
wheels.
"""

LINK_DELAY = 2.0
"""Delay of the loop, in periods, up to which the robot drives at the speed that the agent wants."""

_OTHER_MAP = "the robot has begun to use another map since"

_DELAYS = 15  # number of delays whose median counts
_STOP_ATTEMPTS = 20
_STOP_WAIT = 0.05  # s, between two attempts to stop the wheels


@dataclass(frozen=True)
class Wired:
    """A robot that is connected."""

    link: Connection
    place: str  # Where the robot is, in words
    # The description of the robot that has said hello. Raises a ValueError if it cannot be driven.
    robot: Callable[[Hello], RobotSpec]
    watch: Callable[["Session"], None] = lambda _: (
        None
    )  # Called with the session after each decision
    orders: Orders = field(default_factory=Orders)  # What people ask of the robot
    hint: str = ""  # What to say beside the place while nobody has answered


class Session:
    """Drives a robot, and records what it sends.

    The agent is made for ``recording.robot``. ``watch`` and ``orders`` are as in
    :class:`Wired`, and ``listen`` is called again and again, also while the robot is silent.

    Attributes
    ----------
    reconnections
        Number of times that the robot was heard again after it had been silent for a second, or was
        restarted.
    watchdog_stops
        Number of times that the robot's watchdog has stopped the wheels.
    orders
        What people ask of the robot.
    """

    def __init__(
        self,
        link: Connection,
        hello: Hello,
        agent: LimSlamAgent,
        recording: Recording,
        watch: Callable[["Session"], None] = lambda _: None,
        orders: Orders | None = None,
        listen: Callable[[], None] = lambda: None,
    ) -> None:
        self.link = link
        self.agent = agent
        self.recording = recording
        self.reconnections = self.watchdog_stops = 0
        self._hello = hello
        self._watch = watch
        self.orders = orders or Orders()
        self._listen = listen
        self._destination: Destination | None = None  # that was looked at
        self._way: WayTo | None = None  # that is driven in place of what the agent wants
        self._why_home = "asked to drive home"
        self._ending: str | None = None
        agent.mapper.longest_travel = (
            math.inf
        )  # the recording knows the times, and checks the travel
        self._observed: Row | None = None
        self._last_new = self._last_command = link.clock()
        self._was_stopped = self._is_connected = self._is_silent = False
        self._sent: deque[tuple[int, float]] = deque(maxlen=200)
        self._delays: deque[float] = deque(maxlen=_DELAYS)

    def drive(self, max_time: float, patience: float) -> str:
        """Drive until the agent is done, ``max_time`` (s, by the robot's clock) is over, the robot
        has sent no new telemetry for ``patience`` s, or Ctrl-C is pressed. The wheels are stopped
        in any case, before anything else. Returns why the session has ended.
        """
        self._last_new = self.link.clock()
        reason: str | None = None
        try:
            while reason is None:
                reason = self._turn(max_time, patience)
        except KeyboardInterrupt:
            reason = BY_HAND
        finally:
            with noted_endings() as noted:  # nothing comes between a robot and its stop
                self._stop_wheels()
        for number in noted:
            end_by(number)
        return reason

    @property
    def policy(self) -> Policy:
        """What drives now: the way to where an order says, or the policy of the agent."""
        return self._way or self.agent.policy

    @property
    def state(self) -> str:
        """What the robot is doing, in a word or a few."""
        if self._ending is not None or self.orders.end is not None:
            return "done"
        if self.orders.is_paused:
            return "paused"
        if self._way is None:
            return "exploring"
        return "driving home" if self._destination == HOME else "driving to a goal"

    @property
    def delay(self) -> float:
        """Median time from a measurement to the measurement that shows its answer, s, by the
        robot's clock.

        NaN as long as it is unknown.
        """
        return float(np.median(self._delays)) if self._delays else math.nan

    @property
    def speed_share(self) -> float:
        """Share of the wanted speeds at which the robot drives, 0 to 1: the later it obeys, the
        slower it drives.
        """
        periods = self.delay / self.recording.robot.control_period
        return min(1.0, LINK_DELAY / periods) if periods > 0.0 else 1.0

    @property
    def figures(self) -> dict[str, float | int | None]:
        """Figures of the connection, for ``result.json``."""
        period = self.recording.period
        delay = self.delay
        return {
            "packets": len(self.recording),
            "packets_lost": self.recording.lost,
            "packets_late": self.recording.late + self.link.late,
            "packets_doubled": self.recording.doubled,
            "packets_implausible": self.recording.implausible,
            "lines_bad": self.link.bad_lines,
            "reconnections": self.reconnections,
            "watchdog_stops": self.watchdog_stops,
            "period_s": period if math.isfinite(period) else None,
            "loop_delay_s": delay if math.isfinite(delay) else None,
        }

    def _turn(self, max_time: float, patience: float) -> str | None:
        """Take what has arrived, and answer. The reason to end the session, if there is one."""
        fresh = self._take(self.link.receive(POLL))
        self._listen()
        self._look_at_destination()
        orders = self.orders
        if not fresh:
            if orders.end is not None:
                return orders.end
            if orders.is_paused:
                self._rest()
            self._keep_alive()
            silence = self.link.clock() - self._last_new
            return (
                f"the robot has sent nothing new for {patience:g} s" if silence > patience else None
            )
        for row in fresh:
            self.agent.observe(self.recording.observation(row, self._observed))
            self._observed = row
        if orders.is_paused:
            self.recording.note_action(fresh[-1], np.zeros(2))
            self._rest()
        else:
            self._answer(fresh[-1])
        self._watch(self)
        self._last_new = (
            self.link.clock()
        )  # silence is what the host has listened to, not what it has computed for
        if orders.end is not None or self._ending is not None:
            return orders.end or self._ending
        return OUT_OF_TIME if fresh[-1].time >= max_time else None

    def _look_at_destination(self) -> None:
        """Answer an order to drive somewhere that has come since."""
        orders = self.orders
        goal = orders.destination
        if goal is self._destination:
            return
        if isinstance(goal, Goal):
            belief = self.agent.mapper.belief
            place = np.array([goal.x, goal.y])
            is_here = goal.map_number == belief.map_number
            why_not = objection(place, belief, self.agent.robot) if is_here else _OTHER_MAP
            if why_not:
                orders.drop_destination(f"{goal}: {why_not}")
                goal = None
            else:
                orders.is_paused = False
                orders.answers.append(f"driving to {goal}")
        self._destination = goal
        self._way = None

    def _wheels(self) -> FloatArray:
        """The wanted wheel speeds (2,): those of the agent, or on the way to where an order
        says.
        """
        agent = self.agent
        goal = self._destination
        is_lost_home = goal == HOME and agent.status == "lost"
        if goal is None or is_lost_home:  # it explores, so that it is found again
            self._way = None
            wheels = agent.decide()
            if agent.stop_reason is not None:
                self._explored(agent.stop_reason, is_lost=is_lost_home)
            return wheels
        belief = agent.mapper.belief
        if isinstance(goal, Goal) and goal.map_number != belief.map_number:
            self.orders.drop_destination(f"{goal}: {_OTHER_MAP}")
            return np.zeros(2)
        way = self._way_to(goal)
        wheels = checked_action(way, belief)
        if way.stop_reason is not None and goal == HOME:
            self._ending = f"{self._why_home}; {way.stop_reason}"
        elif way.stop_reason is not None:
            self.orders.destination = None
            self.orders.pause(f"{way.stop_reason}, and waits")
        return wheels

    def _way_to(self, goal: Destination) -> WayTo:
        """The way to a destination. Its place in the map is another one when the robot has found
        its place in an earlier map.
        """
        agent = self.agent
        frame = agent.mapper.prior_frame
        start = np.zeros(2) if frame is None else frame[:2]
        place = np.array([goal.x, goal.y]) if isinstance(goal, Goal) else start
        if self._way is None or not np.array_equal(self._way.goal, place):
            words = str(goal) if isinstance(goal, Goal) else "its start"
            self._way = WayTo(place, words, agent.robot, agent.config.policy)
        return self._way

    def _explored(self, reason: str, *, is_lost: bool) -> None:
        """Do what follows when nothing is left to explore."""
        orders = self.orders
        if is_lost:
            lost = "the robot is lost, and does not know the way to its start"
            self._ending = f"{self._why_home}; {lost}"
        elif orders.when_explored == "home":
            self._why_home = reason
            orders.destination = HOME
        elif orders.when_explored == "pause":
            orders.pause(f"{reason}; the robot waits")
        else:
            self._ending = reason

    def _take(self, messages: list[Message]) -> list[Row]:
        """Record telemetry. The rows that are later than all before them, in order."""
        rows = list[Row]()
        packets = list[Telemetry]()
        for message in messages:
            if isinstance(message, Telemetry):
                packets.append(message)
            elif isinstance(message, Hello) and self._is_restart(message):
                rows += self._record(packets)  # of before the restart
                packets = []
                self._restart(message)
        return rows + self._record(packets)

    def _record(self, packets: list[Telemetry]) -> list[Row]:
        # Lines that have overtaken each other on their way are put in order, if they are here
        # together.
        first = packets[0].seq if packets else 0
        fresh = []
        for packet in sorted(packets, key=lambda each: difference(each.seq, first)):
            row = self.recording.add(packet, self.link.clock() - self._last_new)
            if row is not None and not row.is_late:
                self._note(packet, row)
                fresh.append(row)
        return fresh

    def _is_restart(self, hello: Hello) -> bool:
        """Whether the robot was switched on again."""
        is_same_robot = (hello.version, hello.beams, hello.name) == (
            self._hello.version,
            self._hello.beams,
            self._hello.name,
        )
        return is_same_robot and hello.boot != self._hello.boot

    def _restart(self, hello: Hello) -> None:
        """Go on with a robot that counts from zero again."""
        self._hello = hello
        self.recording.restart()
        self._sent.clear()
        self._is_connected = False
        self.link.greet()

    def _note(self, packet: Telemetry, row: Row) -> None:
        """Note what new telemetry says about the connection."""
        if not self._is_connected and self._observed is not None:
            self.reconnections += 1
        self._is_connected, self._last_new = True, self.link.clock()
        if packet.stopped and not self._was_stopped and self._observed is not None:
            self.watchdog_stops += 1
        self._was_stopped = bool(packet.stopped)
        while self._sent and difference(packet.ack, self._sent[0][0]) >= 0:
            _, asked = self._sent.popleft()
            self._delays.append(row.time - asked)

    def _answer(self, row: Row) -> None:
        """Decide, and send the wheel speeds."""
        action = np.clip(self._wheels(), -1.0, 1.0) * self.speed_share
        self.recording.note_action(row, action)
        seq = self.link.next_seq()
        left, right = (
            round(self.recording.robot.max_wheel_speed * share / MM) for share in action.tolist()
        )
        self._sent.append((seq, row.time))
        self._command(Speeds(seq, self.recording.newest_seq, left, right))
        self._is_silent = False

    def _rest(self) -> None:
        """While paused: stop the wheels once."""
        if not self._is_silent:
            self._command(Stop(self.link.next_seq()))
        self._is_silent = True

    def _command(self, command: Command) -> None:
        self._last_command = self.link.clock()
        self.link.send(command)

    def _keep_alive(self) -> None:
        """Without telemetry, hold the speeds for a short time, then stop; and look for the
        robot.
        """
        now = self.link.clock()
        period = self.recording.robot.control_period
        silence = now - self._last_new
        if silence > SILENT_AFTER or self._observed is None:
            self._is_connected = False
            self.link.greet()
        if (
            self._is_silent
            or self._observed is None
            or silence < HEARTBEAT_AFTER * period
            or now - self._last_command < period
        ):
            return
        seq = self.link.next_seq()
        self._command(Heartbeat(seq) if silence < HOLD * period else Stop(seq))

    def _stop_wheels(self) -> None:
        """Send stops until the robot says that it has obeyed one, for a second at most."""
        for _ in range(0 if self._is_silent else _STOP_ATTEMPTS):
            seq = self.link.next_seq()
            self.link.send(Stop(seq))
            messages = self.link.receive(_STOP_WAIT)
            self._take(messages)
            if any(
                isinstance(each, Telemetry) and difference(each.ack, seq) >= 0 for each in messages
            ):
                return
