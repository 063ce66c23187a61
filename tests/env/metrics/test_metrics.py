"""Metrics: each on a case worked out by hand, the trajectory errors against evo, and a map that is
right but turned.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_env import World, load_world
from limslam_env.geometry import FloatArray, se2, segment
from limslam_env.metrics import (
    AssociationEvent,
    WallSamples,
    association_metrics,
    closure_metrics,
    consistency_metrics,
    contacts_begun,
    coverage_claims,
    coverage_times,
    doors_open,
    dropped_beam_metrics,
    path_length,
    rigid_alignment,
    trajectory_metrics,
    visible_samples,
    wall_metrics,
)

STILL = np.zeros(3)


def poses(*rows: tuple[float, float, float]) -> FloatArray:
    return np.array(rows, dtype=float)


def segments(*rows: tuple[float, float, float, float]) -> FloatArray:
    return np.array(rows, dtype=float).reshape(-1, 4)


def moved(edges: FloatArray, pose: FloatArray) -> FloatArray:
    return se2.transform_points(pose, edges.reshape(-1, 2)).reshape(-1, 4)


def level_samples(edges: FloatArray) -> WallSamples:
    """Samples at 0.025, 0.075, ... m along edges that run from left to right."""
    middles = [np.arange(x1 + 0.025, x2, 0.05) for x1, _, x2, _ in edges]
    points = [
        np.column_stack((x, np.full(len(x), edge[1])))
        for x, edge in zip(middles, edges, strict=True)
    ]
    owner = np.repeat(np.arange(len(edges)), [len(x) for x in middles])
    return np.vstack(points), np.zeros(len(owner)), owner


def tilted(angle_deg: float, length: float = 0.2) -> FloatArray:
    """One segment, tilted about the point (0.5, 0)."""
    half = (
        0.5
        * length
        * np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
    )
    return np.hstack((np.array([0.5, 0.0]) - half, np.array([0.5, 0.0]) + half))[None]


def random_walk(seed: int, steps: int = 400) -> tuple[FloatArray, FloatArray]:
    """A true drive of about 18 m, and one that drifts away from it."""
    generator = np.random.default_rng(seed)
    true = [np.array([1.0, -2.0, 0.3])]
    estimated = [np.array([1.0, -2.0, 0.3])]
    for _ in range(steps):
        motion = np.array([generator.uniform(0.0, 0.09), 0.0, generator.normal(0.0, 0.2)])
        true.append(se2.compose(true[-1], motion))
        estimated.append(se2.compose(estimated[-1], motion * 1.1 + generator.normal(0.0, 0.01, 3)))
    return np.array(true), np.array(estimated)


class TestRigidAlignment:
    def test_a_quarter_turn_and_a_shift(self) -> None:
        # Turned by 90 deg, (x, y) is (-y, x); then shifted by (1, 2).
        estimated = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
        true = np.array([[1.0, 2.0], [1.0, 3.0], [-1.0, 2.0]])
        np.testing.assert_allclose(
            rigid_alignment(true, estimated), [1.0, 2.0, 0.5 * math.pi], atol=1e-12
        )

    def test_points_in_one_place_keep_their_heading(self) -> None:
        # The mean of seven times 0.1 is not exactly 0.1; that must not become an angle.
        true = np.array([[0.3 * i, 0.1 * i * i] for i in range(7)])
        alignment = rigid_alignment(true, np.full((7, 2), 0.1))
        np.testing.assert_allclose(alignment, [0.9 - 0.1, 1.3 - 0.1, 0.0])
        assert alignment[2] == 0.0
        assert rigid_alignment(np.full((7, 2), 0.1), true)[2] == 0.0

    def test_no_points(self) -> None:
        np.testing.assert_array_equal(rigid_alignment(np.zeros((0, 2)), np.zeros((0, 2))), STILL)


class TestTrajectory:
    def test_by_hand(self) -> None:
        true = poses((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0))
        estimated = poses((0, 0, 0), (1, 0, 0), (2, 0.3, 0), (3, 0.4, 2.0 * math.pi + 0.2))
        metrics = trajectory_metrics(true, estimated)
        # Errors 0, 0, 0.3, 0.4; headings wrong by 0, 0, 0, 0.2; relative motions by 0, 0.3, 0.1.
        assert metrics["ate_m"] == pytest.approx(math.sqrt((0.09 + 0.16) / 4.0))
        assert metrics["heading_rmse_deg"] == pytest.approx(math.degrees(0.1))
        assert metrics["final_error_m"] == pytest.approx(0.4)
        assert metrics["rpe_m_per_m"] == pytest.approx(math.sqrt((0.09 + 0.01) / 3.0))

    def test_a_drive_of_less_than_a_metre_has_no_relative_error(self) -> None:
        assert (
            trajectory_metrics(poses((0, 0, 0), (0.9, 0, 0)), poses((0, 0, 0), (1.5, 0, 0)))[
                "rpe_m_per_m"
            ]
            is None
        )

    @pytest.mark.parametrize("seed", [0])
    def test_agrees_with_evo(self, seed: int) -> None:
        pytest.importorskip("evo")
        from evo.core import metrics as evo_metrics
        from evo.core.trajectory import PosePath3D

        def path(planar: FloatArray) -> PosePath3D:
            matrices = np.tile(np.eye(4), (len(planar), 1, 1))
            cos = np.cos(planar[:, 2])
            sin = np.sin(planar[:, 2])
            matrices[:, 0, 0] = cos
            matrices[:, 0, 1] = -sin
            matrices[:, 1, 0] = sin
            matrices[:, 1, 1] = cos
            matrices[:, :2, 3] = planar[:, :2]
            return PosePath3D(poses_se3=list(matrices))

        def rmse(metric: evo_metrics.PE, reference: PosePath3D, estimate: PosePath3D) -> float:
            metric.process_data((reference, estimate))
            return float(metric.get_statistic(evo_metrics.StatisticsType.rmse))

        true, estimated = random_walk(seed)
        reference = path(true)
        estimate = path(estimated)
        aligned = path(estimated)
        aligned.align(reference, correct_scale=False)
        relative = evo_metrics.RPE(
            evo_metrics.PoseRelation.translation_part,
            delta=1.0,
            delta_unit=evo_metrics.Unit.meters,
            all_pairs=False,
            pairs_from_reference=True,
        )
        ours = trajectory_metrics(true, estimated)
        assert ours["ate_m"] == pytest.approx(
            rmse(evo_metrics.APE(), reference, estimate), rel=1e-9
        )
        assert ours["ate_aligned_m"] == pytest.approx(
            rmse(evo_metrics.APE(), reference, aligned), rel=1e-9
        )
        assert ours["rpe_m_per_m"] == pytest.approx(rmse(relative, reference, estimate), rel=1e-9)
        assert ours["ate_m"] > ours["ate_aligned_m"] > 0.05


class TestConsistency:
    TRUE = poses((0, 0, 0), (0.25, 0, 0), (0.5, 0, 0), (0.75, 0, 0))

    def test_by_hand(self) -> None:
        # The first two steps lie before 0.5 m. The others: 0.1^2 / 0.01 = 1, in the band from
        # 0.216 to 9.35, and (0.3^2 + 0.1^2 + 0.2^2) / 0.01 = 14 (the angle wrapped), out of it.
        errors = poses((9, 9, 1), (9, 9, 1), (0.1, 0, 0), (0.3, 0.1, 0.2 - 2.0 * math.pi))
        covariances = np.tile(0.01 * np.eye(3), (4, 1, 1))
        metrics = consistency_metrics(self.TRUE, self.TRUE - errors, covariances)
        assert metrics == {"anees": pytest.approx((1.0 + 14.0) / 2.0 / 3.0), "nees_in_95": 0.5}

    @pytest.mark.parametrize(
        "bad",
        [
            np.zeros((3, 3)),
            np.ones((3, 3)),
            np.diag([-1.0, -1.0, 1.0]),
            np.diag([0.01, -1.0, 0.01]),
        ],
    )
    def test_what_is_no_covariance_counts_as_infinite(self, bad: FloatArray) -> None:
        covariances = np.tile(0.01 * np.eye(3), (4, 1, 1))
        covariances[3] = bad
        metrics = consistency_metrics(self.TRUE, self.TRUE - [0.1, 0.0, 0.0], covariances)
        assert metrics == {"anees": math.inf, "nees_in_95": 0.5}

    def test_a_short_drive_says_nothing(self) -> None:
        none = {"anees": None, "nees_in_95": None}
        assert consistency_metrics(self.TRUE[:2], self.TRUE[:2], np.zeros((2, 3, 3))) == none
        assert consistency_metrics(self.TRUE[:1], self.TRUE[:1], np.zeros((1, 3, 3))) == none

    def test_errors_drawn_from_the_covariance_are_consistent(self) -> None:
        generator = np.random.default_rng(0)
        true = np.column_stack((np.linspace(1.0, 3e4, 20_000), np.zeros(20_000), np.zeros(20_000)))
        root = 0.05 * generator.normal(size=(3, 3))
        estimated = true + generator.normal(size=(20_000, 3)) @ root.T
        metrics = consistency_metrics(true, estimated, np.tile(root @ root.T, (20_000, 1, 1)))
        # Standard deviations of these means: sqrt(6 / 20000) / 3 = 0.006 and sqrt(0.05 * 0.95 /
        # 20000) = 0.0015.
        assert metrics == {
            "anees": pytest.approx(1.0, abs=0.03),
            "nees_in_95": pytest.approx(0.95, abs=0.008),
        }


def room(width: float, height: float) -> list[list[float]]:
    return [
        [0, 0, width, 0],
        [width, 0, width, height],
        [width, height, 0, height],
        [0, height, 0, 0],
    ]


class TestVisibleSamples:
    def test_all_of_env1_can_be_seen(self) -> None:
        world = load_world("env1")
        points, directions, owner = visible_samples(world, 0.10, 1.5)
        # 28 m of outer wall, four hooks of 1.3 + 0.8 m, 8 m of block: 44.4 m at 5 cm.
        assert len(points) == round(44.4 / 0.05)
        np.testing.assert_array_equal(np.bincount(owner), [140] * 4 + [26, 16] * 4 + [40] * 4)
        assert segment.distances(points, world.edges)[np.arange(len(points)), owner].max() < 1e-12
        upright = world.edges[owner, 0] == world.edges[owner, 2]
        np.testing.assert_allclose(
            np.abs(np.cos(directions)), np.where(upright, 0.0, 1.0), atol=1e-12
        )

    def test_what_lies_inside_an_obstacle_is_hidden(self) -> None:
        block = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]])
        walls = np.array([*room(4, 4), [1.5, 2.0, 2.5, 2.0]])
        world = World("box", (4, 4), walls, obstacles=(block,), starts=poses((0.5, 0.5, 0)))
        owner = visible_samples(world, 0.10, 5.0)[2]
        np.testing.assert_array_equal(np.bincount(owner), [80, 80, 80, 80, 0, 40, 40, 40, 40])

    @pytest.mark.parametrize(("shortest", "count"), [({}, 0), ({"shortest": 0.0}, 3)])
    def test_short_sides_give_samples_only_if_asked(
        self, shortest: dict[str, float], count: int
    ) -> None:
        pillar = np.array([[1.0, 1.0], [1.15, 1.0], [1.15, 1.15], [1.0, 1.15]])
        world = World("box", (4, 4), room(4, 4), obstacles=(pillar,), starts=poses((0.5, 0.5, 0)))
        owner = visible_samples(world, 0.10, 5.0, **shortest)[2]
        np.testing.assert_array_equal(np.bincount(owner, minlength=8), [80] * 4 + [count] * 4)

    @pytest.mark.parametrize(
        ("gap", "max_range", "seen"),
        [
            (0.05, 3.0, True),
            # The robot's centre stays 0.1 m away from the dividing wall: 2.1 m from the far one.
            (0.05, 2.05, False),
            (0.0, 3.0, False),
        ],
    )
    def test_a_slit_is_looked_through_but_not_driven_through(
        self, gap: float, max_range: float, seen: bool
    ) -> None:
        walls = np.array([*room(4, 2), [2, 0, 2, 1.0 - gap], [2, 1.0 + gap, 2, 2]])
        world = World("slit", (4, 2), walls, starts=poses((0.5, 0.5, 0)))
        points, _, owner = visible_samples(world, 0.10, max_range)
        counts = np.bincount(owner, minlength=6)
        assert (counts[1] > 0) == seen
        # On this side all; beyond, the steepest sight line goes from (1.9, 1.9) by (2, 0.95) to
        # (2.1, 0).
        assert (counts[3], np.count_nonzero((owner == 0) & (points[:, 0] < 2.0))) == (40, 40)
        assert not np.any((owner == 0) & (points[:, 0] > 2.0) & (points[:, 0] < 2.1))
        assert np.any((owner == 0) & (points[:, 0] > 2.1)) == (gap > 0.0)

    def test_each_start_counts(self) -> None:
        walls = np.array([*room(4, 2), [1, 0, 1, 2]])
        world = World("rooms", (4, 2), walls, starts=poses((0.5, 0.5, 0), (2, 1, 0)))
        np.testing.assert_array_equal(
            np.bincount(visible_samples(world, 0.10, 5.0)[2]), [80, 40, 80, 40, 40]
        )


class TestWalls:
    EDGES = segments((0, 0, 1, 0), (0, 1, 1, 1))
    # Half of the first wall 3 cm beside it, the second 7 cm beside it, and one that is not there.
    ESTIMATE = segments((0, 0.03, 0.5, 0.03), (0, 1.07, 1, 1.07), (3, 3, 3, 4))

    def test_by_hand(self) -> None:
        metrics = wall_metrics(level_samples(self.EDGES), self.EDGES, self.ESTIMATE, STILL)
        # Within 10 cm: of the first wall the 10 samples beside the segment and those at 0.525 and
        # 0.575 past its end (sqrt(0.075^2 + 0.03^2) = 0.081), all 20 of the second: 32 of 40. Of
        # the estimate 10 + 20 of 50. Within 5 cm: 10 and the one at 0.525 (0.039), 11 of 40; 10 of
        # 50.
        assert metrics["wall_recall"] == pytest.approx(0.8)
        assert metrics["wall_precision"] == pytest.approx(0.6)
        assert metrics["wall_f1"] == pytest.approx(2 * 0.8 * 0.6 / 1.4)
        assert metrics["wall_f1_5cm"] == pytest.approx(2 * 0.275 * 0.2 / 0.475)
        assert metrics["wall_f1_aligned"] == pytest.approx(metrics["wall_f1"])
        assert metrics["wall_f1_aligned_5cm"] == pytest.approx(metrics["wall_f1_5cm"])
        assert metrics["spurious_walls"] == 1
        assert metrics["spurious_m"] == pytest.approx(1.0)
        assert metrics["duplicate_m"] == 0.0

    def test_the_alignment_moves_the_estimate(self) -> None:
        metrics = wall_metrics(
            level_samples(self.EDGES), self.EDGES, self.ESTIMATE, np.array([0.0, -0.07, 0.0])
        )
        # 7 cm down: the first is now 4 cm below (0.525 at 0.047 still counts), the second on its
        # wall. Within 5 cm: 31 of 40, and 30 of 50. Unaligned nothing changes.
        assert metrics["wall_f1_aligned_5cm"] == pytest.approx(2 * 0.775 * 0.6 / 1.375)
        assert metrics["wall_f1_aligned"] == pytest.approx(2 * 0.8 * 0.6 / 1.4)
        assert metrics["wall_f1_5cm"] == pytest.approx(2 * 0.275 * 0.2 / 0.475)

    @pytest.mark.parametrize(
        ("angle", "precision"), [(9.0, 1.0), (11.0, 0.0), (-11.0, 0.0), (189.0, 1.0)]
    )
    def test_directions_match_within_10_degrees_and_either_way_round(
        self, angle: float, precision: float
    ) -> None:
        wall = segments((0, 0, 1, 0))
        metrics = wall_metrics(level_samples(wall), wall, tilted(angle), STILL)
        assert metrics["wall_precision"] == precision
        # The segment reaches 0.1 m to either side of 0.5, and counts for 0.1 m more: 8 samples of
        # 20.
        assert metrics["wall_recall"] == pytest.approx(0.4 * precision)

    def test_spurious_is_less_than_half_matched(self) -> None:
        wall = segments((0, 0, 1, 0))
        # Samples match up to x = 1.1: from 0.625 to 1.075 are 10 of 20, from 0.725 on 8 of 20.
        half = wall_metrics(level_samples(wall), wall, segments((0.6, 0, 1.6, 0)), STILL)
        less = wall_metrics(level_samples(wall), wall, segments((0.7, 0, 1.7, 0)), STILL)
        assert (half["spurious_walls"], half["spurious_m"]) == (0, 0.0)
        assert (less["spurious_walls"], less["spurious_m"]) == (1, pytest.approx(1.0))

    def test_duplicates_by_hand(self) -> None:
        wall = segments((0, 0, 1, 0))
        estimate = segments((0, 0.02, 0.6, 0.02), (0.4, -0.02, 1, -0.02))
        # Matching reaches 0.098 m past an end: samples 0.325 ... 0.675 match both, 8 of them.
        assert wall_metrics(level_samples(wall), wall, estimate, STILL)[
            "duplicate_m"
        ] == pytest.approx(0.4)

    @pytest.mark.parametrize("shape", [(0, 4), (0,)])
    def test_an_empty_estimate_scores_zero(self, shape: tuple[int, ...]) -> None:
        metrics = wall_metrics(
            level_samples(self.EDGES), self.EDGES, np.zeros(shape), np.array([1.0, 2.0, 0.5])
        )
        assert len(metrics) == 9
        assert set(metrics.values()) == {0}

    @settings(max_examples=30, deadline=None)
    @given(
        pose=st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.2, 3.2)),
        seed=st.integers(0, 1000),
        name=st.sampled_from(["env1", "square"]),
    )
    def test_the_true_map_moved_rigidly_is_perfect_once_aligned(
        self, pose: tuple[float, float, float], seed: int, name: str
    ) -> None:
        world = load_world(name)
        true = random_walk(seed, steps=30)[0]
        wrong = np.array(pose)
        alignment = rigid_alignment(true[:, :2], se2.transform_points(wrong, true[:, :2]))
        visible = visible_samples(world, 0.10, 1.5, spacing=0.25)
        metrics = wall_metrics(visible, world.edges, moved(world.edges, wrong), alignment)
        assert metrics["wall_f1_aligned"] == 1.0
        assert metrics["wall_f1_aligned_5cm"] == 1.0
        assert metrics["spurious_walls"] == 0


class TestDoors:
    DOOR = segments((0, 0, 1, 0))  # its middle 40 %: 0.3 to 0.7

    @pytest.mark.parametrize(
        ("estimate", "share"),
        [
            (segments(), 1.0),
            (segments((-1, 0, 0.19, 0)), 1.0),  # ends 0.11 m before the middle part
            (segments((-1, 0, 0.21, 0)), 0.0),  # 0.09 m
            (segments((0.81, 0, 2, 0)), 1.0),
            (segments((0.79, 0, 2, 0)), 0.0),
            (segments((0.49, 0.09, 0.51, 0.09)), 0.0),
            (segments((0, 0.11, 1, 0.11)), 1.0),
            (segments((0.5, -1, 0.5, 1)), 1.0),
            (tilted(29.0), 0.0),
            (tilted(31.0), 1.0),
            (tilted(209.0), 0.0),
        ],
    )
    def test_by_hand(self, estimate: FloatArray, share: float) -> None:
        assert doors_open(self.DOOR, estimate) == share

    def test_shares(self) -> None:
        doors = np.vstack((self.DOOR, segments((5, 0, 5, 1), (7, 0, 7, 1), (9, 9, 8, 8))))
        assert doors_open(doors, segments((5, 0.2, 5, 0.9))) == 0.75
        assert doors_open(doors, np.zeros(0)) == 1.0


def test_coverage_times() -> None:
    times = coverage_times(np.array([0.0, 0.1, 0.2, 0.3]), np.array([0.2, 0.5, 0.93, 0.94]))
    assert times == {"time_to_50_s": 0.1, "time_to_90_s": 0.2, "time_to_95_s": None}
    assert set(coverage_times(np.zeros(0), np.zeros(0)).values()) == {None}


def test_path_length() -> None:
    # 3-4-5, then 1 m; headings do not count.
    assert path_length(poses((0, 0, 0), (3, 4, 1), (3, 5, -2))) == pytest.approx(6.0)
    assert path_length(poses((3, 4, 1))) == 0.0


def test_contacts_begun() -> None:
    # The first step may already be in contact.
    assert contacts_begun(np.array([True, True, False, True, False, False, True, True])) == 3
    assert contacts_begun(np.array([False, True])) == 1
    assert contacts_begun(np.zeros(4, dtype=bool)) == 0
    assert contacts_begun(np.zeros(0, dtype=bool)) == 0


class TestCoverageClaims:
    ORIGIN = np.array([-1.0, 2.0])

    def coverable(self) -> np.ndarray:
        # Two rows of five cells of 0.1 m, of four rows: 10 cells, 0.1 m^2, from y = 2.1 to 2.3.
        mask = np.zeros((4, 5), dtype=bool)
        mask[1:3] = True
        return mask

    def claims(self, centres: list[tuple[float, float]]) -> dict[str, float | None]:
        return coverage_claims(np.array(centres), 0.05, self.coverable(), self.ORIGIN, 0.1)

    def test_by_hand(self) -> None:
        right = [(-0.975, 2.125), (-0.525, 2.125), (-0.525, 2.275), (-0.975, 2.275)]
        # Just above, just below, and off the mask to the left and to the right.
        wrong = [(-0.975, 2.325), (-0.975, 2.075), (-1.025, 2.125), (-0.475, 2.125)]
        # A claimed cell has 0.0025 m^2: four of them a tenth of what can be covered.
        assert self.claims(right) == {
            "coverage_claimed": pytest.approx(0.1),
            "coverage_correct": pytest.approx(0.1),
        }
        both = {"coverage_claimed": pytest.approx(0.2), "coverage_correct": pytest.approx(0.1)}
        assert self.claims(right + wrong) == both

    def test_nothing_claimed(self) -> None:
        assert self.claims([]) == {"coverage_claimed": 0.0, "coverage_correct": 0.0}


class TestAssociation:
    def test_by_hand(self) -> None:
        events = [
            AssociationEvent(
                0, is_new=True, true_walls=(4, 4, 4, 2)
            ),  # rightly new: landmark 0 is wall 4
            AssociationEvent(0, is_new=False, true_walls=(4, 4)),  # right
            AssociationEvent(
                0, is_new=False, true_walls=(4, -1, 4)
            ),  # right: two of three readings
            AssociationEvent(0, is_new=False, true_walls=(2, 2, 2)),  # wrong
            AssociationEvent(1, is_new=True, true_walls=(2, 2)),  # rightly new
            AssociationEvent(
                2, is_new=True, true_walls=(4, 4, 4)
            ),  # wrongly new: wall 4 has landmark 0
            AssociationEvent(2, is_new=False, true_walls=(4,)),  # right
            AssociationEvent(1, is_new=False, true_walls=(2, 4)),  # mixed: half is no majority
            AssociationEvent(
                1, is_new=False, true_walls=(-2, -2, -2, 2)
            ),  # mixed: mostly another robot
            AssociationEvent(3, is_new=True, true_walls=(-1, -1)),  # mixed: nothing was there
            AssociationEvent(
                3, is_new=False, true_walls=(0, 0)
            ),  # mixed: landmark 3 stands for no wall
            AssociationEvent(
                4, is_new=True, true_walls=(0, 0)
            ),  # rightly new: landmark 3 is not wall 0's
        ]
        assert association_metrics(events, 5) == {
            "association_right": 3,
            "association_wrong": 1,
            "association_wrongly_new": 1,
            "association_new": 3,
            "association_mixed": 4,
            "association_right_share": pytest.approx(6.0 / 8.0),
        }

    def test_a_wall_that_does_not_exist_is_refused(self) -> None:
        with pytest.raises(ValueError, match="wall 5, but there are 5 walls"):
            association_metrics([AssociationEvent(0, is_new=True, true_walls=(5, 5))], 5)

    def test_closures_by_hand(self) -> None:
        events = [
            AssociationEvent(number, is_new=True, true_walls=(wall, wall))
            for number, wall in enumerate((3, 3, 4, -1))
        ]
        found = closure_metrics(events, [(0, 1), (0, 2), (0, 3), (1, 9)], 5)
        assert found == {"closures_right": 1, "closures_wrong": 1, "closures_mixed": 2}

    def test_beams_on_other_robots_by_hand(self) -> None:
        dropped = np.array([[True, False, True], [False, True, False]])
        seen = np.array([[-2, -2, 3], [-1, -1, 0]])
        found = dropped_beam_metrics(dropped, seen)
        assert found == {
            "robot_beams_dropped": 0.5,
            "robot_beams_dropped_wrongly": pytest.approx(2.0 / 3.0),
        }
        assert set(dropped_beam_metrics(dropped & (seen == 9), seen + 9).values()) == {None}
