"""``limslam live``: a live robot explores, and its folder."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limslam_agent.cli import options as take
from limslam_agent.cli.options import LiveOptions
from limslam_agent.cli.settings import Given, exploring_agent, write_live_settings
from limslam_agent.command_options import takes
from limslam_agent.terminal import progress_bar, say, warn

if TYPE_CHECKING:
    from limslam_agent.config.presets import AgentConfig
    from limslam_agent.live.orders import Orders
    from limslam_agent.live.protocol import Hello
    from limslam_agent.live.recording import Recording
    from limslam_agent.live.session import Session, Wired
    from limslam_agent.live.transports import Transport
    from limslam_agent.mapping.team import LimSlamAgent
    from limslam_agent.places.saved_map import SavedMap
    from limslam_env.interface import RobotSpec

# By this factor, the period of telemetry is another one than the hello says.
_OTHER_CLOCK = 3.0


@takes(LiveOptions)
def live(
    robot: take.LiveRobot = None,
    config: take.Config = None,
    ros_arguments: take.RosArguments = None,
    **told: Any,
) -> None:
    """Explore with a live robot, and draw its map. Ctrl-C stops the robot and draws the map of what
    it has seen.
    """
    from limslam_agent.places.saved_map import read_saved_map
    from limslam_agent.runs.policies import check_belief_policy

    given = Given.read(config, {**told, "robot": robot})
    options = given.merged(LiveOptions())
    ways = {
        "--serial": options.serial is not None,
        "--udp": options.udp is not None,
        "--ros2": options.ros2,
    }
    places = [name for name, is_given in ways.items() if is_given]
    if not places:
        raise ValueError(
            "either --serial PORT, --udp PORT or --ros2 is needed, the place where the robot is"
        )
    if len(places) > 1:
        named = f"{', '.join(places[:-1])} and {places[-1]}"
        raise ValueError(f"{named} are different places: the robot is at one of them only")
    if ros_arguments and not options.ros2:
        raise ValueError(f"{ros_arguments[0]}: only --ros2 takes arguments for ROS 2")
    if options.udp is None and (options.token or options.listen != LiveOptions.listen):
        raise ValueError("--listen and --token are for --udp: no other robot is in a network")
    agent = exploring_agent(given, options)
    check_belief_policy(options.policy)
    warn(given.warnings(options.preset))
    prior_map = None if options.map is None else read_saved_map(options.map)
    with _wired(options, given.replay_robot(), ros_arguments or []) as wired:
        carry_out(options, agent, wired, prior_map)


def carry_out(
    options: LiveOptions, config: "AgentConfig", wired: "Wired", prior_map: "SavedMap | None"
) -> None:
    """Drive a robot, write the folder of the session, and print its summary."""
    from limslam_agent.live.folder import session_lines, write_session
    from limslam_agent.live.link import NoRobotError
    from limslam_agent.live.recording import Recording, kept
    from limslam_agent.live.session import Session
    from limslam_agent.mapping.team import LimSlamAgent
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.runs.policies import policies_by_belief
    from limslam_agent.runs.policy_file import naming_lines_of
    from limslam_env.messages import counted

    target = options.out or Path("runs") / "live"
    with new_folder(target, force=options.force, numbered=options.out is None) as folder:
        typer.echo(f"waiting     for a robot {wired.place}{wired.hint}", err=True)
        hello = wired.link.first_hello(options.patience)
        recording = Recording(wired.robot(hello), hello)
        _warn_about(hello)
        copy = folder.target.with_name(f"{folder.target.name}-log.npz")
        left = [f"what the robot has sent is in {copy}: limslam replay draws the map"]
        with kept(recording, copy, lambda: warn(left)) as save_if_due:
            policies = policies_by_belief(options.policy, recording.robot, config, robots=1, seed=0)
            policy = policies[0] if policies else None
            agent = LimSlamAgent(recording.robot, config, policy, prior_map=prior_map)
            if options.stay:
                wired.orders.when_explored = "pause"
            with (
                _display(options, agent, wired, save_if_due) as watch,
                _listening(wired.orders) as listen,
            ):
                session = Session(wired.link, hello, agent, recording, watch, wired.orders, listen)
                with naming_lines_of(options.policy):
                    reason = session.drive(options.max_time, options.patience)
            if not len(recording):
                raise NoRobotError(
                    f"the robot {hello.name} has said hello, but has sent no telemetry with "
                    f"{counted(hello.beams, 'range')}{wired.link.trouble}"
                )
            typer.echo("smoothing   and writing the map", err=True)
            result = write_session(folder.beside, session, f"live {hello.name}", reason, prior_map)
            write_live_settings(folder.beside, options, config)
    warn([*recording.log().readings_notes, *_about_clock(recording)])
    say(*session_lines(result), f"results     {folder.target}")


@contextmanager
def _wired(
    options: LiveOptions, described: "RobotSpec | None", ros_arguments: Sequence[str]
) -> "Iterator[Wired]":
    """The connection that the options name."""
    if options.ros2:
        from limslam_agent.live.ros2.wiring import wired_by_ros

        with wired_by_ros(described, ros_arguments) as robot:
            yield robot
        return
    from limslam_agent.live.link import Link
    from limslam_agent.live.session import Wired
    from limslam_agent.live.transports import SerialTransport

    hint = ""
    if options.serial is not None:
        place = f"at {options.serial}"
        transport: Transport = SerialTransport(options.serial, options.baud)
    else:
        place = f"at UDP port {options.udp} of {options.listen}"
        transport = _udp_transport(options)
        if options.listen == LiveOptions.listen:
            hint = " (this computer; --listen 0.0.0.0 hears its networks too)"
    with closing(transport):
        yield Wired(Link(transport), place, lambda hello: _robot_of(hello, described), hint=hint)


def _udp_transport(options: LiveOptions) -> "Transport":
    from limslam_agent.live.transports import UdpTransport

    transport = UdpTransport(
        options.udp or 0, options.listen, options.token, lambda line: warn([line])
    )
    if options.listen != LiveOptions.listen and options.token is None:
        warn(["anybody in the network can say that it is the robot: --token keeps others out"])
    return transport


def _robot_of(hello: "Hello", described: "RobotSpec | None") -> "RobotSpec":
    """The robot of ``--robot``, else the shipped robot that it says it is."""
    from limslam_agent.robot_file import robot_named
    from limslam_env.robots import ROBOTS

    if described is None and hello.name not in ROBOTS:
        raise ValueError(
            f"no shipped robot is called {hello.name!r}: describe the robot in a file for --robot"
        )
    robot = described or robot_named(hello.name)
    if len(robot.beams) != hello.beams:
        raise ValueError(
            f"the robot {hello.name} has {hello.beams} beams, but its description has "
            f"{len(robot.beams)}"
        )
    return robot


@contextmanager
def _display(
    options: LiveOptions, agent: "LimSlamAgent", wired: "Wired", save_if_due: Any
) -> "Iterator[Any]":
    """The progress bar of a session, and its page in a browser; yields what is called after each
    decision.
    """
    from limslam_agent.inspect.live_page import Controls, Follower, live_page
    from limslam_env.messages import counted

    with progress_bar("driving", options.max_time) as advance, ExitStack() as opened:
        follower = None
        events = list[str]()
        if options.watch:
            controls = Controls(wired.orders.obey, lambda: _shown(wired.orders))
            page = opened.enter_context(live_page(f"live, {wired.place}", controls=controls))
            typer.echo(f"watch       {page.address}", err=True)
            follower = Follower(page, round(options.max_time / agent.robot.control_period) + 1)

        def watch(session: "Session") -> None:
            wired.watch(session)
            save_if_due()
            newest = session.recording.newest
            seconds = 0.0 if newest is None else newest.time
            walls = counted(len(agent.slam.segments), "wall")
            lost = counted(session.recording.lost, "line")
            state = f"{walls}  {agent.status}  {session.state}  {lost} lost"
            advance(seconds, f"{seconds:6.1f} s  {state}")
            while len(events) < len(agent.mapper.places.events):
                events.append(agent.mapper.places.events[len(events)].record["event"])
                say(f"place       {events[-1]} after {seconds:.1f} s", err=True)
            if follower is not None:
                follower.note(agent.mapper, [session.policy], seconds)

        yield watch
        if follower is not None:
            follower.end()


@contextmanager
def _listening(orders: "Orders") -> "Iterator[Callable[[], None]]":
    """Takes orders by keys, and prints what becomes of all orders; yields what does both."""
    from limslam_agent.live.keys import KEYS, typed_keys

    printed = 0
    with typed_keys() as typed:
        if typed is not None:
            typer.echo(f"keys        {KEYS}", err=True)

        def listen() -> None:
            nonlocal printed
            if typed is not None:
                orders.press(typed())
            for answer in orders.answers[printed:]:
                printed += 1
                say(f"order       {answer}", err=True)

        yield listen
        listen()


def _shown(orders: "Orders") -> dict[str, Any]:
    """What the page shows of the orders."""
    return {"paused": orders.is_paused, "answer": (orders.answers or [""])[-1]}


def _warn_about(hello: "Hello") -> None:
    if hello.watchdog_ms < 2 * hello.period_ms:
        words = (
            f"the robot's watchdog of {hello.watchdog_ms} ms is shorter than two periods of "
            f"{hello.period_ms} ms"
        )
        warn([f"{words}: one lost line stops the wheels"])


def _about_clock(recording: "Recording") -> list[str]:
    """A warning if the robot's clock does not count the milliseconds that its hello says."""
    said, clock = recording.robot.control_period, recording.period
    if not (clock < said / _OTHER_CLOCK or clock > said * _OTHER_CLOCK):
        return []
    words = f"by the robot's clock, {1e3 * clock:.0f} ms pass between two lines"
    return [f"{words}, and by its hello {1e3 * said:.0f} ms: does its clock count ms?"]
