"""Datasets: what is recorded, what Minari loads, and what is refused."""

import json
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.command_line import call

from benchmarks.__main__ import main
from benchmarks.dataset.drives import DatasetConfig, record_drive
from benchmarks.dataset.files import DRIVES, SUMS, check_dataset, dataset_id, make_dataset, read_truth
from benchmarks.suite.suite import load_suite
from limslam_agent.arena.tracks import plans_of
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.measurements.processes import Failure

SMALL = DatasetConfig(plans=2, policies=("learned", "random"), size=20, max_time=1.5)


class Here:
    """Runs jobs in this process, and can stop as if it had been killed."""

    def __init__(self, most=1000):
        self.most, self.jobs = most, []

    def run(self, jobs, work):
        for job in jobs[: self.most]:
            self.jobs.append(job)
            try:
                yield job, work(job)
            except ArithmeticError as error:
                yield job, Failure(str(error))
        if len(jobs) > self.most:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def minari():
    pytest.importorskip("h5py", reason="needs the extra datasets")
    return pytest.importorskip("minari", reason="needs the extra datasets")


@pytest.fixture(scope="module")
def made(minari, tmp_path_factory):  # noqa: ARG001 (skips where it is missing)
    folder = tmp_path_factory.mktemp("made") / "dataset"
    with pytest.raises(KeyboardInterrupt):
        make_dataset(SMALL, folder, Here(most=3))
    rest = Here()
    result = make_dataset(SMALL, folder, rest)
    assert not result.failures
    return folder, rest


@pytest.fixture
def copied(made, tmp_path):
    return shutil.copytree(made[0], tmp_path / "dataset")


def loaded(minari, folder, policy):
    return minari.MinariDataset(folder / dataset_id(policy) / "data")


def test_a_drive_is_what_the_wrapped_environment_gives_again():
    job = SMALL.suite.jobs[0]
    arrays = record_drive(SMALL, job).series
    env = SMALL.environment()
    observation, info = env.reset(seed=job.seed, options={"world": job.world})
    for step, action in enumerate(arrays["actions"]):
        for name, part in observation.items():
            np.testing.assert_array_equal(arrays[f"observations/{name}"][step], part)
        np.testing.assert_array_equal(arrays["truth/pose"][step], info["pose"])
        observation, reward, *_, info = env.step(action)
        assert arrays["rewards"][step] == np.float32(reward)
    np.testing.assert_array_equal(arrays["observations/grid"][-1], observation["grid"])
    assert np.ptp(arrays["truth/pose"][:, :2], axis=0).max() > 0.05, "the robot has driven"
    assert arrays["truncations"].tolist() == [False] * 14 + [True]


def test_a_policy_that_stops_cuts_the_episode_short(monkeypatch):
    job = SMALL.suite.jobs[0]
    decide, calls = LimSlamTeam.decide, []

    def tired(team):
        calls.append(1)
        if len(calls) == 5:
            team.policies[0].stop_reason = "tired"
        return decide(team)

    monkeypatch.setattr(LimSlamTeam, "decide", tired)
    outcome = record_drive(SMALL, job)
    assert (outcome.metrics["steps"], outcome.metrics["stop_reason"]) == (4, "tired")
    assert outcome.metrics["lost_s"] == 0.0
    assert len(outcome.series["observations/pose"]) == 5
    assert outcome.series["truncations"].tolist() == [False, False, False, True]


def test_no_plan_of_a_dataset_is_used_elsewhere():
    plans = range(DatasetConfig().first_plan, DatasetConfig().first_plan + 1_000_000)
    others = [plan.world for plan in plans_of("exploration")] + [job.world for job in load_suite("explore").jobs]
    assert not {int(world.split(":")[1]) for world in others} & set(plans)


def test_the_same_command_goes_on(made):
    folder, rest = made
    assert [job.key for job in rest.jobs] == [SMALL.suite.jobs[3].key]
    assert not (folder / DRIVES).exists()
    assert make_dataset(SMALL, folder, Here()) is None


def test_minari_loads_what_was_recorded(made, minari):
    data = loaded(minari, made[0], "learned")
    job = SMALL.suite.jobs[2]
    arrays, episode = record_drive(SMALL, job).series, data[1]
    assert (job.policy, data.total_episodes, data.total_steps) == ("learned", 2, 30)
    np.testing.assert_array_equal(episode.actions, arrays["actions"])
    np.testing.assert_array_equal(episode.observations["covariance"], arrays["observations/covariance"])
    np.testing.assert_array_equal(episode.infos["wheels"], arrays["infos/wheels"])
    assert data.observation_space["grid"].shape == (1, 20, 20)


def test_a_learner_gets_no_truth_and_an_evaluation_does(made, minari):
    episode = loaded(minari, made[0], "learned")[0]
    assert set(episode.observations) == {"pose", "covariance", "grid", "ranges"}
    assert set(episode.infos) == {"wheels", "status"}
    truth = read_truth(made[0], "learned", 0)
    assert set(truth) == {"pose", "coverage", "collision", "walls"}
    assert truth["pose"].shape == (16, 3)
    assert truth["walls"].shape[1] == 4


def test_the_card_says_what_is_there(made):
    text = (made[0] / "README.md").read_text(encoding="utf-8")
    assert "`random:300000` to `random:300001`" in text
    assert "| `limslam/learned-v0` | 2 |" in text
    assert "the longest time is over (2)" in text
    assert "{" not in text


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda folder: (folder / SUMS).unlink(), "no complete dataset"),
        (lambda folder: (folder / "README.md").write_text("another card"), "another checksum"),
        (lambda folder: (folder / "results.jsonl").unlink(), "is missing"),
    ],
)
def test_harm_is_noticed(copied, harm, message):
    assert check_dataset(copied, repeated_steps=0).endswith("2 datasets, 4 episodes, 60 steps")
    harm(copied)
    with pytest.raises(ValueError, match=message):
        check_dataset(copied)


@pytest.mark.parametrize(
    ("name", "row", "value", "message"),
    [
        ("actions", 3, -1.0, "differs at step"),
        ("observations/ranges", 3, 1.23, "ranges differs at step 3"),
        ("rewards", 3, 7.0, "the reward differs at step 3"),
        ("terminations", 3, True, "must end once"),
    ],
)
def test_wrong_data_with_right_checksums_are_noticed(copied, monkeypatch, name, row, value, message):
    import h5py

    with h5py.File(copied / dataset_id("random") / "data/main_data.hdf5", "r+") as file:
        file["episode_1"][name][row] = value
    monkeypatch.setattr("benchmarks.dataset.files._check_sums", lambda _: 0)
    with pytest.raises(ValueError, match=message):
        check_dataset(copied)


@pytest.mark.usefixtures("minari")
def test_a_drive_that_fails_is_named(tmp_path, monkeypatch):
    def broken(*_, **__):
        raise ArithmeticError("no plan")

    monkeypatch.setattr(LimSlamTeam, "decide", broken)
    result = make_dataset(replace(SMALL, plans=1), tmp_path / "dataset", Here())
    assert [reason for _, reason in result.failures] == ["no plan"] * 2
    assert not (tmp_path / "dataset" / SUMS).exists()
    monkeypatch.undo()
    again = make_dataset(replace(SMALL, plans=1), tmp_path / "dataset", Here(), retry_failed=True)
    assert not again.failures
    assert json.loads((tmp_path / "dataset" / "dataset.json").read_bytes())["plans"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--plans", "0"], "a dataset has 1 to 1000000 plans, not 0"),
        (["--policies", "oracle"], "no policy 'oracle' can drive for a dataset"),
        (["--policies", "random,random"], "each policy is named once"),
        (["--max-time", "0"], "a drive takes at most"),
    ],
)
def test_what_is_no_dataset_is_refused_in_one_line(tmp_path, arguments, message):
    done = call(main, "dataset", *arguments, "--out", tmp_path / "dataset")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert message in done.stderr
    assert not (tmp_path / "dataset").exists()


EXAMPLE = Path(__file__).parents[2] / "examples" / "offline_rl.py"


def test_the_example_learns_from_it(made):
    pytest.importorskip("torch", reason="needs torch, as the extra rl does")
    options = ["--data", made[0], "--policies", "learned,random", "--held-out", "1", "--updates", "2"]
    command = [sys.executable, EXAMPLE, *options]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    count, words = lines[0].split(" ", 1)
    assert (int(count) > 0, words) == (True, "decisions on 1 plans")
    assert [line.split("|")[0].strip() for line in lines[-5:]] == ["", "learned", "random", "clone", "IQL"]


def test_the_example_knows_left_from_right(minari):  # noqa: ARG001 (skips where it is missing)
    pytest.importorskip("torch", reason="needs torch, as the extra rl does")
    example = runpy.run_path(str(EXAMPLE))
    # Ahead for 0.3 m, then to the left; and standing still.
    ahead = np.column_stack((np.linspace(0.0, 0.3, 11), np.zeros(11), np.zeros(11)))
    left = np.column_stack((np.full(9, 0.3), np.linspace(0.03, 0.27, 9), np.full(9, 0.5 * np.pi)))
    assert example["directions"](np.concatenate((ahead, left))).tolist() == [0, 3, 6, -1]
    # Free in front, a wall to the left, and unknown behind: the way to the frontier is behind.
    grid = np.zeros((1, 40, 40), dtype=np.uint8)
    grid[:, 10:25, 12:28] = 127
    grid[:, 10:25, 11] = grid[:, 9, 11:29] = grid[:, 10:25, 28] = 255
    grid[:, 10:25, 13] = 255
    seen = example["view"](grid, np.linspace(0.2, 1.2, 6, dtype=np.float32))
    around = seen[: 33 * 24].reshape(33, 24)
    assert around[20:30, 12].max() == 1.0 > around[20:30, 0].max(), "nearer to the frontier behind than ahead"
    assert around[10:20, 5:8].max() > 0.0 == around[10:14, 17:20].max(), (
        "a wall to the left is nearer than to the right"
    )
    flipped = example["view"](grid[:, :, ::-1], np.linspace(1.2, 0.2, 6, dtype=np.float32))
    difference = np.abs(example["mirrored"](seen[None])[0] - flipped)
    assert difference.mean() < 0.1 * np.abs(seen - flipped).mean()
