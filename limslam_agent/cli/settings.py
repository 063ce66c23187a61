"""What a command is told: by its options, and by the file of ``--config``, over which options
win.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

from limslam_agent.cli.options import LiveOptions, Options, ReplayOptions, RunOptions
from limslam_agent.command_options import with_told
from limslam_agent.config.tables import (
    SettingsError,
    Table,
    read_toml,
    table_of,
    updated,
    write_toml,
)
from limslam_agent.runs.run_spec import LONGEST_TIME

if TYPE_CHECKING:
    from limslam_agent.config.presets import AgentConfig
    from limslam_agent.runs.run_config import RunConfig
    from limslam_env.config import NoiseConfig
    from limslam_env.interface import RobotSpec

FILE = "run.toml"
"""The file in a result's folder that repeats the command."""

_MAX_WHEEL_STD = 1.0  # m, after 1 m

_TIME_PER_GROUND = 10.0  # s for each m^2 of a world: twice what an exploration needs

# These say where results go, not how they are made.
_OUTPUT = {"dry_run", "out", "force", "video", "watch"}

# The true noise of wheels, which the kind of range sensors does not change.
_WHEELS = {
    "wheel_variance",
    "encoder_resolution",
    "wheel_mismatch",
    "axle_mismatch",
    "slip_rate",
    "slip_share",
}
# The settings of an agent that belong to its preset.
_OF_PRESET = ("estimator", "smoothing", "smooths_runs", "renewal")


@dataclass(frozen=True)
class Given:
    """What a user gave: the file of ``--config`` with its content, and options of the command line
    by their names.
    """

    path: Path | None
    table: Table
    options: Table

    @classmethod
    def read(cls, path: Path | None, arguments: Table) -> "Given":
        """Read the file; arguments that are None were not given."""
        options = {name: value for name, value in arguments.items() if value is not None}
        return cls(path, read_toml(path) if path else {}, options)

    def merged(self, defaults: Options) -> Options:
        """The options: those on the command line, else those of the file, else the defaults."""
        known: list[str] = [field.name for field in fields(defaults)]
        unknown = set(self.table).difference(known, defaults.tables)
        if unknown:
            there = ", ".join([*known, *(f"[{name}]" for name in defaults.tables)])
            raise SettingsError(
                f"{self.path}: {min(unknown)}: there is no such setting; there are {there}"
            )
        in_file = {name: value for name, value in self.table.items() if name not in defaults.tables}
        merged = updated(defaults, in_file, str(self.path))
        paths = {
            name: self.beside_file(value)
            for name, value in vars(merged).items()
            if isinstance(value, Path)
        }
        merged = with_told(merged, paths)
        return with_told(
            merged, {name: value for name, value in self.options.items() if name in known}
        )

    def beside_file(self, path: Path) -> Path:
        """A path of the file, which is relative to the file's folder."""
        return path if self.path is None else self.path.absolute().parent / path

    def agent(self, base: "AgentConfig") -> "AgentConfig":
        """The agent's settings: those of the preset with the changes in the file's table ``agent``.

        Options win over the table: a preset on the command line that is not the file's brings its
        own estimator, and ``--noise`` sets the noise that the agent assumes.
        """
        table = self.table.get("agent", {})
        preset_in_file = self.table.get("preset", base.preset)
        if not isinstance(table, Mapping):
            raise SettingsError(f"{self.path}: agent: must be a table, not {table!r}")
        if "noise" in self.options and isinstance(noise := table.get("noise"), Mapping):
            table = {
                **table,
                "noise": {name: value for name, value in noise.items() if name != "range_std"},
            }
        if isinstance(policy := table.get("policy"), Mapping) and "until" in policy:
            raise SettingsError(
                f"{self.path}: agent.policy.until: is set as until, outside of all tables"
            )
        if base.preset != preset_in_file:
            # A mistake in the file is a mistake, even if the table is not used.
            updated(
                self._preset_in_file(preset_in_file, base),
                table,
                f"{self.path}: agent",
                fixed={"preset"},
            )
            table = {name: value for name, value in table.items() if name not in _OF_PRESET}
        return updated(base, table, f"{self.path}: agent", fixed={"preset"})

    def warnings(self, preset: str) -> list[str]:
        """A line for tables of the file that are for another preset."""
        in_file = self.table.get("preset", preset)
        table = self.table.get("agent", {})
        unused = ", ".join(f"agent.{name}" for name in _OF_PRESET if name in table)
        if in_file == preset or not unused:
            return []
        return [f"{self.path}: not used, since the preset is {preset} and not {in_file}: {unused}"]

    def _preset_in_file(self, name: str, base: "AgentConfig") -> "AgentConfig":
        from limslam_agent.config.presets import preset

        try:
            return preset(name, base.noise)
        except ValueError as error:
            raise SettingsError(f"{self.path}: preset: {error}") from error

    def true_noise(self, base: "NoiseConfig") -> "NoiseConfig":
        """The true noise of the simulator besides that of the option ``noise``."""
        noise = updated(
            base,
            self.table.get("true_noise", {}),
            f"{self.path}: true_noise",
            fixed={"sensor_noise"},
        )
        if self.options.get("sharp"):
            noise = type(base).sharp(
                **{name: value for name, value in vars(noise).items() if name in _WHEELS}
            )
        if "odometry_noise" in self.options:
            noise = replace(noise, wheel_variance=_wheel_variance(self.options["odometry_noise"]))
        try:
            mismatch = self.options.get("wheel_mismatch", noise.wheel_mismatch)
            return replace(noise, wheel_mismatch=mismatch)
        except ValueError as error:
            raise SettingsError(f"--wheel-mismatch: {error}") from error

    def robot(self) -> "RobotSpec":
        """The robot of ``--robot``, else the paper's robot with the changes in the file's table
        ``robot``.
        """
        from limslam_agent.robot_file import robot_named
        from limslam_env.interface import RobotSpec

        named = self.options.get("robot")
        if named is not None:
            return robot_named(named)
        return updated(RobotSpec(), self.table.get("robot", {}), f"{self.path}: robot")

    def replay_robot(self) -> "RobotSpec | None":
        """The robot that recorded a table. None where neither ``--robot`` nor the file names
        one.
        """
        return self.robot() if "robot" in self.options or "robot" in self.table else None

    @contextmanager
    def naming(self, name: str) -> Iterator[None]:
        """Name the file and the key in an error about a setting that the file has set."""
        try:
            yield
        except ValueError as error:
            if name in self.options or name not in self.table:
                raise
            raise SettingsError(f"{self.path}: {name}: {error}") from error


def _wheel_variance(std: float) -> float:
    """The variance of a wheel's travel after 1 m, m^2, that ``--odometry-noise`` says."""
    if not 0.0 <= std <= _MAX_WHEEL_STD:
        raise SettingsError(
            f"--odometry-noise must be a number from 0 to {_MAX_WHEEL_STD:g}, not {std:g}"
        )
    return std**2


def run_options(given: Given) -> RunOptions:
    """The options of a run; paths of a world and a policy in the file are relative to the file."""
    options = given.merged(RunOptions())
    for name, ends in (("world", r"\.\w+"), ("policy", r"\.py:\w+")):
        value = getattr(options, name)
        # The size of a random plan may have a decimal point.
        is_file = re.search(rf"{ends}$", value) and not value.startswith("random:")
        if name not in given.options and name in given.table and is_file:
            options = with_told(options, {name: str(given.beside_file(Path(value)))})
    return replace(options, ablation=None) if options.ablation == "none" else options


def exploring_agent(given: Given, options: RunOptions | LiveOptions) -> "AgentConfig":
    """The settings of an agent that explores, with the changes in the file of ``--config``."""
    from limslam_agent.config.presets import preset, with_until
    from limslam_env.interface import NominalNoise

    with given.naming("preset"):
        agent = preset(options.preset, NominalNoise(options.noise))
    with given.naming("until"):
        agent = with_until(agent, options.until)
    return given.agent(agent)


def run_config(given: Given, options: RunOptions) -> "RunConfig":
    """What is run. Without a longest time, that of a large world grows with its ground."""
    from limslam_agent.config.presets import ablated
    from limslam_agent.runs.policies import check_policy
    from limslam_agent.runs.run_config import RunConfig
    from limslam_env.config import NoiseConfig

    spec = options.spec
    with given.naming("world"):
        world = options.load(options.world)
    agent = exploring_agent(given, options)
    with given.naming("ablation"):
        _ = options.ablation and ablated(agent, options.ablation)
    with given.naming("policy"):
        check_policy(options.policy, options.laps, options.robots)
    if "odometry_noise" in given.options:
        variance = _wheel_variance(given.options["odometry_noise"])
        agent = replace(agent, noise=replace(agent.noise, wheel_variance=variance))
    if not {"max_time"} & (given.options.keys() | given.table.keys()):
        ground = world.size[0] * world.size[1]
        spec["max_time"] = min(max(options.max_time, _TIME_PER_GROUND * ground), LONGEST_TIME)
    true_noise = given.true_noise(NoiseConfig())
    return RunConfig(
        **spec | {"world": world}, true_noise=true_noise, robot=given.robot(), settings=agent
    )


def write_run_settings(folder: Path, config: "RunConfig", world: str) -> None:
    """Write the file that repeats a run: all settings as they were in effect, before the
    ablation. ``world`` is the world as it was asked for.
    """
    from limslam_agent.config.presets import preset
    from limslam_env.interface import NominalNoise

    agent = config.settings or preset(config.preset, NominalNoise(config.noise))
    noise = table_of(config.true_noise)
    del noise["sensor_noise"]
    table = {
        **_option_table(config.spec),
        "world": _named(world),
        "policy": _kept_policy(folder, config.policy),
        "true_noise": noise,
        "robot": table_of(config.robot),
        "agent": _agent_table(agent, config.noise),
    }
    write_toml(
        folder / FILE, table, f"All settings of a run: limslam run --config {FILE} repeats it."
    )


def _kept_policy(folder: Path, policy: str) -> str:
    """The name of a policy. A policy's file is copied into the run's folder, with the files beside
    it that it has imported, so that the folder repeats the run.
    """
    from limslam_agent.runs.policy_file import files_of, is_file_policy, short_name

    if is_file_policy(policy):
        for name, path in files_of(policy).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            copyfile(path, folder / name)
    return short_name(policy)


def replay_agent(given: Given, options: ReplayOptions) -> "AgentConfig":
    """The settings of a replay's agent, before the calibration."""
    from limslam_agent.config.presets import preset
    from limslam_agent.replay.options import odometry_config
    from limslam_env.interface import NominalNoise

    told = given.options
    in_file = odometry_config(options.odometry_noise, options.odometry_bias)
    agent = given.agent(
        replace(preset(options.preset, NominalNoise(options.noise)), odometry=in_file)
    )
    # An option wins over the file's table of the same settings.
    odometry = odometry_config(
        told.get("odometry_noise"), told.get("odometry_bias"), agent.odometry
    )
    return replace(agent, odometry=odometry)


def write_replay_settings(
    folder: Path, options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None" = None
) -> None:
    """Write the file that repeats a replay: all settings as they were in effect, before the
    calibration.
    """
    in_agent = ("odometry_noise", "odometry_bias")
    told = {name: value for name, value in vars(options).items() if name not in in_agent}
    table = _option_table(told)
    table["agent"] = _agent_table(agent, options.noise)
    if robot is not None:
        table["robot"] = table_of(robot)
    write_toml(
        folder / FILE,
        table,
        f"All settings of a replay: limslam replay --config {FILE} repeats it.",
    )


def write_live_settings(folder: Path, options: LiveOptions, agent: "AgentConfig") -> None:
    """Write the file that repeats the map of a live session from its log, which lies beside the
    file.
    """
    from limslam_agent.output.finished_run import LOG

    told = _option_table(
        {"log": LOG, "preset": options.preset, "noise": options.noise, "map": options.map}
    )
    table = {**told, "agent": _agent_table(agent, options.noise)}
    write_toml(
        folder / FILE,
        table,
        f"All settings of a map: limslam replay --config {FILE} draws it again.",
    )


def _option_table(options: Table) -> dict[str, Any]:
    return {
        name: str(value.absolute()) if isinstance(value, Path) else value
        for name, value in options.items()
        if name not in _OUTPUT
    }


def _agent_table(agent: "AgentConfig", noise: float) -> dict[str, Any]:
    """The agent's settings without those that follow from the options."""
    table = table_of(agent)
    del table["preset"], table["policy"]["until"]
    if agent.noise.range_std == noise:
        del table["noise"]["range_std"]
    return table


def _named(world: str) -> str:
    """The name of a shipped world or a floor plan, or that of the file in the run's folder."""
    from limslam_agent.output.finished_run import WORLD
    from limslam_env.worlds.formats.loading import RANDOM, shipped_worlds

    return world if world in shipped_worlds() or world.startswith(RANDOM) else WORLD
