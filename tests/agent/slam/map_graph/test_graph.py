"""Parts of the graph of local maps: key poses, factors, walls and links, matching, loops and their
covariances.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.corridors import corridor_log

from limslam_agent.config.graph import GraphConfig, LocalMapConfig, PointConfig, WallLineConfig
from limslam_agent.slam.graph.factors import geman_mcclure, prior, relation
from limslam_agent.slam.graph.graph import DegenerateError, Factors, Graph, Nodes
from limslam_agent.slam.map_graph import matching
from limslam_agent.slam.map_graph.agreement import VisitCounts, judged_together
from limslam_agent.slam.map_graph.chunk_graph import (
    ChunkGraph,
    Hops,
    solve_annealed,
)
from limslam_agent.slam.map_graph.factors import odometry, point_link, point_on_wall, wall_on_axes
from limslam_agent.slam.map_graph.joined_map import loop_to_joined
from limslam_agent.slam.map_graph.key_poses import (
    ERRORS,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    delayed,
    event_poses,
    integrate,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.map_graph.local_maps import HIT, LocalMap, draw_grid, thinned
from limslam_agent.slam.map_graph.loops import Loop, supported
from limslam_agent.slam.map_graph.matching import (
    NO_MATCH,
    Window,
    match,
    match_covariance,
    search_grid,
)
from limslam_agent.slam.map_graph.point_links import (
    PointCloud,
    find_normals,
    links_across,
    point_cloud,
)
from limslam_agent.slam.map_graph.posterior import aligned_covariance
from limslam_agent.slam.map_graph.wall_lines import WallLines, lines_in
from limslam_env.geometry import se2

RNG = np.random.default_rng(1)


def wandering(count=200, beams=3):
    moves = np.column_stack(
        (RNG.normal(0.05, 0.02, count), RNG.normal(0.0, 0.02, count), RNG.normal(0.0, 0.05, count))
    )
    odometry = np.zeros((count, 3))
    for row in range(1, count):
        odometry[row] = se2.compose(odometry[row - 1], moves[row])
    angles = np.linspace(-1.5, 1.5, beams)
    ranges = RNG.uniform(0.3, 4.0, (count, beams))
    origins = RNG.normal(0.0, 0.1, (beams, 2))
    return LogData(np.arange(count) * 0.1, odometry, ranges, ranges < 3.5, origins, angles, 5.0)


def keys_of(log):
    return choose_keys(log, GraphConfig())


def test_two_corrections_after_each_other_are_one():
    log = wandering()
    first = np.array([0.05, 0.03, -0.02, 0.2, 0.02])
    second = np.array([-0.02, 0.01, 0.04, -0.1, 0.01])
    twice = corrected(corrected(log, first), second).odometry
    once = corrected(log, joined_bias(first, second)).odometry
    # The direction of a motion turns by half of the missing heading, which is not exactly additive.
    # Odometry ends with the log, so poses after the end are missing.
    assert np.abs(se2.wrap_angle(twice[:, 2] - once[:, 2]))[2:-2].max() < 1e-3
    assert np.abs(twice[2:-2, :2] - once[2:-2, :2]).max() < 5e-3
    assert np.abs(once - log.odometry).max() > 0.1


def test_a_log_whose_times_do_not_tell_its_events_apart_keeps_its_odometry():
    log = wandering(60)
    same = replace(log, time=np.repeat(np.arange(20.0), 3))
    for delay in (0.0, 0.3):
        np.testing.assert_array_equal(delayed(same, delay).odometry, log.odometry)
    np.testing.assert_array_equal(delayed(log, 0.0).odometry, log.odometry)


def test_each_beam_gives_a_point_after_its_own_way():
    log = wandering()
    turns = np.arange(len(log.time))[:, None] % log.hit.shape[1] == np.arange(log.hit.shape[1])
    keys = keys_of(replace(log, ranges=np.full_like(log.ranges, 1.0), hit=turns))
    assert len(keys.point_event) == len(log.time)
    slow = replace(log, odometry=log.odometry * [0.2, 0.2, 0.0], hit=np.ones_like(log.hit))
    points = choose_keys(slow, GraphConfig(keys=PointConfig(points_per_metre=1000.0)))
    per_beam = len(points.point_event) / log.hit.shape[1]
    driven = points.driven
    assert 0.6 * driven / 0.015 < per_beam <= driven / 0.015 + 1


def test_a_break_of_odometry_parts_a_log_in_two():
    log = wandering()
    stds = np.array([[2.0, 2.0, 1.0]])
    parted = keys_of(replace(log, breaks=np.array([90]), break_stds=stds))
    plain = keys_of(log)
    (key,) = parted.breaks
    assert parted.first_event[key] == 90
    np.testing.assert_allclose(parted.step_variances[key - 1], stds[0] ** 2, rtol=0.01)
    assert parted.step_variances[: key - 1].max() < 0.01
    assert parted.driven == pytest.approx(plain.driven, abs=0.1)
    assert parted.key_driven[-1] == pytest.approx(plain.key_travel[-1], abs=0.3)
    # A correction of the motion across moves no event before it.
    local = odometry_trajectory(parted, np.zeros(3))
    moved = local.poses.copy()
    moved[key:, :2] += 5.0
    before = event_poses(parted, Trajectory(moved, local.bias))[:90]
    np.testing.assert_allclose(before, event_poses(parted, local)[:90], atol=1e-4)


def central_differences(function, values, step=1e-6):
    columns = []
    for place in range(values.size):
        high = values.copy()
        low = values.copy()
        high.flat[place] += step
        low.flat[place] -= step
        columns.append((function(high) - function(low)) / (2.0 * step))
    return np.stack(columns, axis=-1)


def curved_log(count=60):
    time = np.arange(count, dtype=float)
    turn = np.cumsum(RNG.normal(0.0, 0.1, count))
    odometry = np.column_stack((np.cumsum(0.1 * np.cos(turn)), np.cumsum(0.1 * np.sin(turn)), turn))
    ranges = RNG.uniform(0.5, 3.0, (count, 2))
    hit = np.ones((count, 2), dtype=bool)
    return LogData(time, odometry, ranges, hit, np.zeros((2, 2)), np.array([1.5, -1.5]), 5.0)


def test_relation_jacobian():
    poses = RNG.normal(0.0, 2.0, (2, 3))
    measured = RNG.normal(0.0, 1.0, (1, 3))
    ends = np.array([[0, 1]])
    wanted = central_differences(lambda each: relation(each, ends, measured).errors[0], poses)
    assert np.allclose(relation(poses, ends, measured).jacobian[0], wanted, atol=1e-7)


def test_odometry_jacobian_by_poses_and_constant_errors():
    keys = keys_of(curved_log())
    bias = np.array([0.02, 0.01, -0.02, 0.1, 0.03])
    poses = odometry_trajectory(keys, np.array([1.0, 2.0, 0.5])).poses + RNG.normal(
        0.0, 0.02, (len(keys), 3)
    )
    jacobian = odometry(keys, Trajectory(poses, bias)).jacobian
    by_bias = central_differences(lambda each: odometry(keys, Trajectory(poses, each)).errors, bias)
    by_poses = central_differences(
        lambda each: odometry(keys, Trajectory(each, bias)).errors, poses
    )
    # The missed heading is spread along the step: second-order terms of it are left out.
    assert np.allclose(jacobian[:, :, 6:], by_bias, atol=1e-3)
    for row in range(len(keys) - 1):
        assert np.allclose(jacobian[row, :, :6], by_poses[row, :, 3 * row : 3 * row + 6], atol=1e-7)


def test_noise_of_straight_drives_does_not_make_the_gain_of_turns_too_small():
    generator = np.random.default_rng(3)
    steps = np.zeros((2000, 3))
    steps[:, 0] = 0.3
    steps[100::200, 2] = 1.5
    noisy = steps.copy()
    noisy[:, 2] += np.radians(1.0) * generator.standard_normal(len(steps))
    path, reported = (integrate(np.zeros(3), each) for each in (steps, noisy))
    count = len(path)
    ranges = np.full((count, 1), 5.0)
    beam = np.zeros((1, 2)), np.zeros(1)
    keys = keys_of(LogData(np.arange(count) * 0.5, reported, ranges, ranges < 5.0, *beam, 5.0))
    bias = np.zeros(ERRORS)
    for _ in range(5):
        nodes = Nodes(poses=(len(keys), 3), errors=(1, ERRORS))
        graph = Graph(nodes, order=nodes.columns("errors")[0, :3])
        graph.add(odometry(keys, Trajectory(path[keys.first_event], bias)))
        bias = bias + graph.solve()[nodes.columns("errors")[0]]
    assert abs(bias[2]) < 0.05


def rotation(heading):
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


STD = 0.2


def test_link_jacobian():
    poses = RNG.normal(0.0, 2.0, (2, 3))
    own = RNG.normal(0.0, 2.0, (2, 2))
    normals = np.array([[0.0, 1.0], [np.cos(0.7), np.sin(0.7)]])

    def factor(both):
        turns = [rotation(each[2]) for each in both]
        places = np.array([turn @ each for turn, each in zip(turns, own, strict=True)])
        turned = np.array([turn @ each for turn, each in zip(turns, normals, strict=True)])
        cloud = PointCloud(
            np.arange(2), np.zeros(2), places + both[:, :2], turned, np.ones(2, dtype=bool)
        )
        return point_link(both, cloud, np.array([[0, 1]]), STD)

    wanted = central_differences(lambda both: factor(both).errors[0, 0], poses)
    assert np.allclose(factor(poses).jacobian[0, 0], wanted, atol=1e-6)


def test_wall_jacobian():
    pose = RNG.normal(0.0, 2.0, 3)
    place = RNG.normal(0.0, 2.0, 2)
    centre = RNG.normal(0.0, 2.0, 2)
    angle = 0.4

    def factor(unknowns):
        x, y, heading, turn, offset = unknowns
        moved = centre + offset * np.array([np.cos(angle), np.sin(angle)])
        seen = rotation(heading) @ place + [x, y]
        first = np.zeros(1, dtype=int)
        cloud = PointCloud(first, first, seen[None], np.zeros((1, 2)), first)
        walls = WallLines(np.array([angle + turn]), moved[None], first, first)
        return point_on_wall(np.array([[x, y, heading]]), cloud, walls, STD)

    unknowns = np.append(pose, [0.0, 0.0])
    wanted = central_differences(lambda each: factor(each).errors[0, 0], unknowns)
    assert np.allclose(factor(unknowns).jacobian[0, 0], wanted, atol=1e-6)


def test_most_walls_are_parallel_to_one_of_two_axes():
    # Two walls of each direction, which are 1.5 degrees off a right angle; all are up to half a
    # degree off, and an oblique one has few points.
    off = np.radians([0.5, 0.3, -0.1, -0.3, 31.0])
    axes = 0.7 + np.radians([0.0, 91.5, 180.0, -88.5, 0.0])
    lines = np.repeat(np.arange(5), [20, 20, 20, 20, 5])
    walls = WallLines(axes + off, np.zeros((5, 2)), np.arange(len(lines)), lines)
    factors = wall_on_axes(walls, 0.05)
    assert factors.keys[1][1][:4].tolist() in ([0, 1, 0, 1], [1, 0, 1, 0])
    graph = Graph(Nodes(walls=(5, 2), axes=(2, 1)), order=np.arange(12))
    graph.add_robust(factors, geman_mcclure(2.0))
    graph.add(prior("walls", np.zeros((5, 2)), np.eye(2) / 0.05**2))
    graph.add(prior("axes", np.zeros((2, 1)), np.eye(1)))
    # All but the oblique wall turn half of the way to the walls that are parallel to them.
    turns = np.degrees(graph.solve()[:10:2])
    assert abs(turns[4]) < 0.1
    assert np.allclose(turns[:4], [-0.15, -0.15, 0.15, 0.15], atol=0.03)


def test_robust_factors_are_summed_with_their_weights():
    ends = np.array([[0, 1], [0, 2], [0, 1], [1, 2]])
    keys = (("poses", ends[:, 0]), ("lines", ends[:, 1]))
    jacobian = RNG.normal(size=(4, 1, 5))
    errors = np.array([[0.5], [-2.0], [0.1], [15.0]])
    graph = Graph(Nodes(poses=(2, 3), lines=(3, 2)))
    weights = graph.add_robust(Factors(keys, errors, jacobian), geman_mcclure(2.0))
    assert np.allclose(weights, (1.0 + (errors[:, 0] / 2.0) ** 2) ** -2)
    plain = Graph(graph.nodes)
    plain.add(Factors(keys, errors, jacobian, weights[:, None, None]))
    assert np.allclose(graph.gradient, plain.gradient)
    for each in (graph, plain):
        each.add(prior("poses", np.zeros((2, 3)), np.eye(3)))
        each.add(prior("lines", np.zeros((3, 2)), np.eye(2)))
    assert np.allclose(graph.solve(), plain.solve())


def test_the_sparse_step_equals_a_dense_one():
    ends = np.array([[0, 1], [1, 2], [0, 2]])
    poses = RNG.normal(0.0, 1.0, (3, 3))
    information = np.tile(np.diag([4.0, 5.0, 6.0]), (3, 1, 1))
    factors = relation(poses, ends, RNG.normal(0.0, 1.0, (3, 3)), information)
    graph = Graph(Nodes(poses=(3, 3)))
    graph.add(factors)
    columns = graph.nodes.columns_of(factors.keys)
    dense = np.zeros((9, 9))
    for row in range(3):
        wide = np.zeros((3, 9))
        wide[:, columns[row]] = factors.jacobian[row]
        dense += wide.T @ information[row] @ wide
    step = np.zeros(9)
    step[3:] = -np.linalg.solve(dense[3:, 3:], graph.gradient[3:])
    assert np.allclose(graph.solve(), step)
    covariance = np.zeros((9, 9))
    covariance[3:, 3:] = np.linalg.inv(dense[3:, 3:])
    by = factors.jacobian[1]
    wanted = by @ covariance[np.ix_(columns[1], columns[1])] @ by.T
    assert np.allclose(graph.covariances(factors)[1], wanted)


def test_a_cleared_graph_takes_other_factors_of_the_same_nodes():
    ends = np.array([[0, 1], [1, 2], [0, 2]])
    poses = RNG.normal(0.0, 1.0, (3, 3))
    first, second = (relation(poses, ends, RNG.normal(0.0, 1.0, (3, 3))) for _ in range(2))
    graph = Graph(Nodes(poses=(3, 3)))
    graph.add(first)
    graph.solve()
    graph.clear()
    graph.add(replace(second, jacobian=2.0 * second.jacobian))
    other = Graph(graph.nodes)
    other.add(replace(second, jacobian=2.0 * second.jacobian))
    assert np.array_equal(graph.solve(), other.solve())


def random_factors(nodes, pairs, kinds, rng):
    """Factors with four random errors each, between pairs of nodes of two kinds."""
    keys = tuple(zip(kinds, np.array(pairs).T, strict=True))
    width = nodes.columns_of(keys).shape[1]
    errors = rng.normal(size=(len(pairs), 4))
    return Factors(keys, errors, rng.normal(size=(len(pairs), 4, width)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("is_ordered", [False, True])
def test_steps_and_covariances_equal_dense_ones(seed, is_ordered):
    rng = np.random.default_rng(seed)
    nodes = Nodes(poses=(12, 3), lines=(7, 2))
    chain = [(each, each + 1) for each in range(11)]
    loops = rng.choice(12, (4, 2), replace=True)
    loops = [tuple(sorted(pair)) for pair in loops if pair[0] != pair[1]]
    seen = [(pose, line) for line in range(7) for pose in rng.choice(12, 3, replace=False)]
    added = [
        random_factors(nodes, chain, ("poses", "poses"), rng),
        random_factors(nodes, loops, ("poses", "poses"), rng),
        random_factors(nodes, seen, ("poses", "lines"), rng),
    ]
    # All but the first pose, in any order of the nodes
    order = None
    if is_ordered:
        free = [nodes.columns("poses")[1:], nodes.columns("lines")]
        of_nodes = [row for each in free for row in each]
        order = np.concatenate([of_nodes[each] for each in rng.permutation(len(of_nodes))])
    graph = Graph(nodes, order)
    hessian = np.zeros((nodes.size, nodes.size))
    for factors in added:
        graph.add(factors)
        for columns, jacobian in zip(nodes.columns_of(factors.keys), factors.jacobian, strict=True):
            hessian[np.ix_(columns, columns)] += jacobian.T @ jacobian
    inverse = np.zeros_like(hessian)
    inverse[3:, 3:] = np.linalg.inv(hessian[3:, 3:])
    assert np.allclose(graph.solve(), -inverse @ graph.gradient)
    right = rng.normal(size=(nodes.size, 5))
    white = graph.whitened(right)
    assert np.allclose(white.T @ white, right.T @ inverse @ right)
    for kind in ("poses", "lines"):
        columns = nodes.columns(kind)
        wanted = inverse[columns[:, :, None], columns[:, None, :]]
        assert np.allclose(graph.marginals(kind), wanted)


def test_unknowns_without_factors_are_refused_each_time():
    nodes = Nodes(poses=(4, 3))
    known = relation(np.zeros((4, 3)), np.array([[0, 1], [1, 2]]), np.zeros((2, 3)))
    for order in (None, np.arange(3, 12)):
        graph = Graph(nodes, order)
        graph.add(known)
        for _ in range(2):
            with pytest.raises(DegenerateError, match="do not determine"):
                graph.solve()


def test_a_graph_that_was_solved_is_cleared_before_factors_are_added():
    factors = relation(np.zeros((2, 3)), np.array([[0, 1]]), np.zeros((1, 3)))
    graph = Graph(Nodes(poses=(2, 3)))
    graph.add(factors)
    graph.solve()
    with pytest.raises(ValueError, match="after it is cleared"):
        graph.add(factors)


CONFIG = GraphConfig()


def test_normals_of_a_wall_point_to_the_sensor():
    x = np.linspace(0.0, 3.0, 61)
    places = np.column_stack((x, np.full(61, 1.0)))
    normals, good = find_normals(places, np.column_stack((x, np.zeros(61))), x, 0.0)
    assert good.all()
    assert np.allclose(normals, [0.0, -1.0], atol=1e-9)


def test_walls_of_a_window_are_found_with_their_points():
    generator = np.random.default_rng(2)
    along = np.sort(generator.uniform(0.0, 4.0, 60))
    sides = [
        np.column_stack((along, np.full(60, y))) + generator.normal(0.0, 0.01, (60, 2))
        for y in (1.0, -1.0)
    ]
    places = np.vstack(sides)
    normals = np.vstack((np.tile([0.0, -1.0], (60, 1)), np.tile([0.0, 1.0], (60, 1))))
    lines = lines_in(
        places, normals, np.ones(120, dtype=bool), np.array([[0, 120]]), WallLineConfig()
    )
    assert len(lines.angles) == 2
    assert sorted(np.round(lines.centres[:, 1], 1)) == [-1.0, 1.0]
    assert np.bincount(lines.lines).tolist() == [60, 60]
    assert np.abs(np.cos(lines.angles)).max() < 0.02


def test_visits_are_linked_to_the_nearest_point_of_another_visit():
    log, truth = corridor_log(laps=2)
    keys = choose_keys(log, CONFIG)
    cloud = point_cloud(keys, Trajectory(truth[keys.first_event], np.zeros(ERRORS)))
    links = links_across(cloud, 0.3, 13.5)
    assert len(links) > 0.3 * len(cloud.travel)
    point = links[len(links) // 2, 0]
    other = links[links[:, 0] == point][0, 1]
    fits = cloud.good & (np.abs(cloud.travel - cloud.travel[point]) > 13.5)
    fits &= cloud.normals @ cloud.normals[point] > 0.85
    apart = np.where(fits, np.hypot(*(cloud.places - cloud.places[point]).T), np.inf)
    assert apart[other] == apart.min() <= 0.3


MAPS = LocalMapConfig()


def corner(generator, count=60):
    """Points on two walls at a right angle, seen from the origin."""
    along = generator.uniform(-3.0, 3.0, count)
    aside = generator.uniform(-1.0, 2.0, count // 2)
    return np.vstack(
        (
            np.column_stack((along, np.full(count, 2.0))),
            np.column_stack((np.full(len(aside), 3.0), aside)),
        )
    )


def chunk_of(places):
    origins = np.zeros_like(places)
    grid = draw_grid(places, origins, 4.5, MAPS)
    return LocalMap(0.0, thinned(places, MAPS.cell), grid, MAPS.cell)


def score_at(chunk, points, pose):
    """The mean of the cells at points, as shares of a hit; cells outside of the grid are
    unknown.
    """
    places = se2.transform_points(pose, points)
    cells = np.floor(places / chunk.cell).astype(int) + len(chunk.grid) // 2
    inside = ((cells >= 0) & (cells < len(chunk.grid))).all(axis=1)
    return chunk.grid[tuple(cells[inside].T)].sum() / HIT / len(points)


@pytest.mark.parametrize("seed", range(3))
def test_the_best_pose_of_a_window_is_found(seed):
    generator = np.random.default_rng(seed)
    chunk = chunk_of(corner(generator))
    points = thinned(
        se2.transform_points(generator.normal(0.0, 0.3, 3), corner(generator, 30)), MAPS.cell
    )
    window = Window(1.3, np.radians(12.0))
    guess = generator.normal(0.0, 0.2, 3)
    found = match(search_grid(chunk.grid, MAPS.cell, window.shift), points, guess, window, -1.0)
    best = NO_MATCH
    for turn, x, y in np.ndindex(9, 27, 27):
        pose = guess + np.array([(x - 13) * 0.1, (y - 13) * 0.1, np.radians(3.0 * (turn - 4))])
        penalty = 0.05 * (((x - 13) ** 2 + (y - 13) ** 2) / 170.0 + (turn - 4) ** 2 / 17.0)
        best = max(best, score_at(chunk, points, pose) - penalty)
    assert found.score == pytest.approx(best, abs=1e-6)
    assert score_at(chunk, points, found.pose) >= best


def test_points_beyond_the_grid_are_found():
    generator = np.random.default_rng(5)
    chunk = chunk_of(corner(generator))
    points = chunk.points + np.array([9.0, -9.0])
    grid = search_grid(chunk.grid, MAPS.cell, 10.0)
    found = match(grid, points, np.zeros(3), Window(10.0, 0.2), 0.5)
    assert found.pose[:2] == pytest.approx([-9.0, 9.0], abs=0.11)


def test_nothing_is_found_where_nothing_fits():
    generator = np.random.default_rng(8)
    chunk = chunk_of(corner(generator))
    points = generator.uniform(-3.0, 3.0, (80, 2))
    grid = search_grid(chunk.grid, MAPS.cell, 2.0)
    assert match(grid, points, np.zeros(3), Window(2.0, 0.3), 0.9).score == NO_MATCH
    assert match(grid, points[:0], np.zeros(3), Window(2.0, 0.3), 0.0).score == NO_MATCH


def corridor(*ends, posts=(), half=4.0):
    """A corridor of 8 m with end walls and posts at one side at these x, seen from its axis."""
    along = np.arange(-half, half, 0.05)
    walls = [np.column_stack((along, np.full(len(along), y))) for y in (-1.0, 1.0)]
    return np.vstack(
        (
            *walls,
            *[np.column_stack((np.full(40, x), np.linspace(-1.0, 1.0, 40))) for x in ends],
            *[np.column_stack((np.full(20, x), np.linspace(-1.0, -0.4, 20))) for x in posts],
        )
    )


@pytest.mark.parametrize(
    ("half", "ends", "posts", "std"),
    [
        (4.0, (), (), (20.0, 40.0)),
        (4.0, (4.0,), (), (0.05, 0.3)),
        (4.0, (-4.0,), (), (0.05, 0.3)),
        (4.0, (), (-3.0, -1.0, 1.0, 3.0), (20.0, 40.0)),
        # Farther than the corridor was seen, nothing speaks for or against a shift.
        (2.0, (2.0,), (0.0,), (0.05, 0.3)),
    ],
)
def test_a_match_is_known_along_a_corridor_only_by_what_stands_out_there(half, ends, posts, std):
    places = corridor(*ends, posts=posts, half=half)
    origins = np.column_stack((0.9 * places[:, 0], np.zeros(len(places))))
    grid = draw_grid(places, origins, 4.5, MAPS)
    chunk = LocalMap(0.0, thinned(places, MAPS.cell), grid, MAPS.cell)
    search = search_grid(chunk.grid, MAPS.cell, 4.0)
    guess = np.array([0.0, 0.0, 0.3])
    points = se2.transform_points(se2.inverse(guess), chunk.points)
    turned = (
        se2.transform_points(se2.inverse(guess), places),
        se2.transform_points(se2.inverse(guess), origins),
    )
    back = search_grid(draw_grid(*turned, 4.5, MAPS), MAPS.cell, 4.0)
    _, covariance = match_covariance(search, points, guess, (back, chunk.points))
    assert std[0] < np.sqrt(covariance[0, 0]) < std[1]
    assert np.sqrt(covariance[1, 1]) < 0.2


def test_too_few_points_to_tell_places_apart_are_not_matched():
    chunk = chunk_of(corner(np.random.default_rng(3)))
    grid = search_grid(chunk.grid, MAPS.cell, 0.6)
    window = Window(0.6, 0.2)
    enough = chunk.points[: matching.LEAST_POINTS]
    assert match(grid, enough, np.zeros(3), window, 0.6).score > 0.9
    assert match(grid, enough[1:], np.zeros(3), window, 0.6).score == NO_MATCH


def counts(contradicted):
    shares = np.asarray(contradicted)
    number = np.arange(len(shares))
    return VisitCounts(3 * number, np.full(len(shares), 200), 200 - shares, shares)


def test_a_stretch_is_doubtful_if_it_is_contradicted_more_often_than_confirmed():
    visits = counts([20] * 20 + [140] * 5 + [20] * 20)
    assert visits.doubtful().tolist() == [63, 66, 69]
    assert visits.shares == pytest.approx((1.0 - 1500 / 9000, 1500 / 9000))
    assert len(counts([80] * 25).doubtful()) == 0  # clutter
    unseen = np.zeros(9, dtype=np.int64)
    assert len(VisitCounts(np.arange(9), np.full(9, 200), unseen, unseen).doubtful()) == 0


def test_a_stretch_of_one_log_does_not_count_around_chunks_of_the_next_log():
    visits = counts([2] * 20 + [200] * 3 + [10] * 20)
    assert visits.doubtful().tolist() == [60, 63, 66]
    assert visits.doubtful(seam=66).tolist() == [60, 63]


INFORMATION = np.diag([1.0 / 0.1**2, 1.0 / 0.1**2, 1.0 / 0.03**2])


def ring(laps=2, sides=4, each=6):
    """True poses of chunks 2.5 m apart round a square."""
    pose = np.zeros(3)
    poses = [np.zeros(3)]
    for step in range(laps * sides * each):
        turn = np.pi / 2.0 if step % each == each - 1 else 0.0
        pose = se2.compose(pose, np.array([2.5, 0.0, turn]))
        poses.append(pose)
    return np.array(poses)


def drifting(truth, bias=0.05, seed=0):
    """Hops with a constant heading error, and noise."""
    generator = np.random.default_rng(seed)
    motions = se2.between(truth[:-1], truth[1:])
    motions[:, 2] += bias
    motions += generator.normal(0.0, [0.03, 0.03, 0.01], motions.shape)
    covariance = np.diag([0.1**2, 0.1**2, 0.05**2])
    return Hops(motions, np.tile(covariance, (len(motions), 1, 1)))


def loops_of(truth, pairs):
    return [Loop(a, b, se2.between(truth[a], truth[b]), INFORMATION, 0.7) for a, b in pairs]


def worst(poses, truth):
    return np.hypot(*(poses - truth)[:, :2].T).max()


@pytest.fixture
def truth():
    return ring()


def right_pairs(truth):
    return [(number, number + 24) for number in range(0, len(truth) - 24, 3)]


def test_right_loops_bring_a_drifting_chain_back(truth):
    hops = drifting(truth)
    alone, _ = solve_annealed(truth[0], hops, [])
    closed, weights = solve_annealed(truth[0], hops, loops_of(truth, right_pairs(truth)))
    revisits = np.hypot(*(closed[24:48] - closed[:24])[:, :2].T)
    assert worst(alone, truth) > 10.0
    assert revisits.max() < 0.5
    assert np.all(weights > 0.5)


def test_wrong_loops_lose_their_weight(truth):
    generator = np.random.default_rng(4)
    hops = drifting(truth, bias=0.02)
    right = loops_of(truth, right_pairs(truth))
    wrong = [
        Loop(int(a), int(a) + 15, generator.normal(0.0, 2.0, 3), INFORMATION, 0.7)
        for a in generator.integers(0, 30, 5)
    ]
    with_wrong, weights = solve_annealed(truth[0], hops, right + wrong)
    without, _ = solve_annealed(truth[0], hops, right)
    assert np.all(weights[len(right) :] < 0.1)
    assert np.all(weights[: len(right)] > 0.5)
    assert worst(with_wrong, without) < 0.5


def blank_map(number):
    return LocalMap(2.5 * number, np.zeros((0, 2)), np.zeros((2, 2), np.int8), 0.1)


def test_a_lone_loop_has_no_support_and_two_that_agree_have(truth):
    travel = 2.5 * np.arange(len(truth))
    pair = loops_of(truth, [(0, 24), (1, 25)])
    astray = Loop(10, 40, np.array([1.0, 1.0, 1.0]), INFORMATION, 0.8)
    same_chunk = loops_of(truth, [(12, 36), (13, 36)])
    found = supported([*pair, astray, *same_chunk], truth, travel, 2.5)
    assert found.tolist() == [True, True, False, False, False]
    assert supported([], truth, travel, 2.5).tolist() == []


def test_a_loop_that_is_free_along_a_corridor_supports_none_that_claims_to_know(truth):
    travel = 2.5 * np.arange(len(truth))
    exact, other = loops_of(truth, [(0, 24), (1, 25)])
    free = replace(other, information=np.diag([30.0**-2, 100.0, 1000.0]))
    assert supported([exact, free], truth, travel, 2.5).tolist() == [False, True]


def stretch_of_equal_niches(number, posts):
    """A chunk whose middle is at x = 2.5 ``number`` m of a corridor with posts, m."""
    middle = 2.5 * number
    x = np.arange(middle - 3.5, middle + 3.5, 0.05)
    aside = np.where(np.abs(x[:, None] - posts).min(axis=1) < 0.3, 0.6, 1.0)
    places = np.vstack([np.column_stack((x - middle, side * aside)) for side in (1.0, -1.0)])
    origins = places * (1.0, 0.0)
    grid = draw_grid(places, origins, 5.0, MAPS)
    return LocalMap(middle, thinned(places, MAPS.cell), grid, MAPS.cell)


def test_a_row_of_loops_tells_equal_rooms_apart():
    # One post of a row is missing.
    posts = np.delete(np.arange(-6.0, 40.0, 3.0), 6)
    maps = [stretch_of_equal_niches(number, posts) for number in range(12)]
    later = [replace(each, travel=each.travel + 100.0) for each in maps]
    poses = np.column_stack((2.5 * np.arange(12.0), np.zeros(12), np.zeros(12)))
    # The second visit is believed one post further on.
    believed = np.vstack((poses, poses + np.array([3.0, 0.0, 0.0])))
    free = np.diag([30.0**-2, 100.0, 1000.0])
    loops = [Loop(each, 12 + each, np.array([1.0, 0.0, 0.0]), free, 0.8) for each in range(12)]
    row = judged_together(loops, believed, maps + later, MAPS)
    found = np.array([loop.relative[0] for loop in row[2:8]])
    np.testing.assert_allclose(found, 0.0, atol=0.11)
    assert all(loop.information[0, 0] > 0.5 for loop in row[2:8])
    (alone,) = judged_together(loops[11:], believed, maps + later, MAPS)
    assert alone.information[0, 0] < 30.0**-2 * 1.1
    assert judged_together([], believed, maps + later, MAPS) == []


def test_the_covariance_stays_symmetric_and_positive_over_many_loops():
    truth = ring(laps=6)
    hops = drifting(truth, bias=0.0)
    blank = [blank_map(number) for number in range(len(truth))]
    graph = ChunkGraph(blank[0], truth[0], MAPS)
    for newest in range(1, len(truth)):
        graph.add(blank[newest], hops.motions[newest - 1 : newest], hops.covariances[newest - 1])
        graph.close(loops_of(truth, [(old, newest) for old in range(newest % 24, newest - 12, 24)]))
    size = 3 * len(truth)
    keys = tuple(("poses", np.array([number])) for number in range(len(truth)))
    every = Factors(keys, np.zeros((1, size)), np.eye(size)[None])
    covariance = graph.covariances(every)[0]
    last = covariance[-3:, -3:]
    assert np.allclose(graph.last_covariance, last, atol=1e-12)
    positions = np.delete(np.arange(size), np.s_[2::3])
    aligned = aligned_covariance(covariance[np.ix_(positions, positions)], graph.poses[:, :2])
    assert graph.position_std == pytest.approx(np.sqrt(np.trace(aligned[-2:, -2:])))
    assert np.allclose(covariance, covariance.T, atol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9


def driven_back(turned, std, count=14):
    """The graph of a drive out and back, whose odometry has turned by an angle that is not true,
    rad, in the last hop, which has a standard deviation, rad. Also the true poses.
    """
    truth = np.zeros((count, 3))
    truth[:, 0] = 2.5 * np.minimum(np.arange(count), count - 1 - np.arange(count))
    graph = ChunkGraph(blank_map(0), truth[0], MAPS)
    for number in range(1, count):
        motion = se2.between(truth[number - 1], truth[number])
        stds = np.array([0.05, 0.05, 0.01])
        if number == count - 3:
            motion = motion + np.array([0.0, 0.0, turned])
            stds[2] = std
        graph.add(blank_map(number), motion[None], np.diag(stds**2))
    return graph, truth


@pytest.mark.parametrize(("std", "bounds"), [(0.7, (0.0, 0.3)), (0.05, (2.0, 6.0))])
def test_a_loop_far_from_the_poses_counts_where_the_odometry_allows_it(std, bounds):
    graph, truth = driven_back(0.7, std)
    graph.close(loops_of(truth, [(0, 13)]))
    off = np.hypot(*(graph.poses - truth)[13, :2])
    assert bounds[0] <= off <= bounds[1]


def test_a_doubtful_loop_counts_once_another_one_agrees():
    graph, truth = driven_back(0.7, 0.7)
    before = graph.poses
    one, other = loops_of(truth, [(0, 13), (1, 12)])
    graph.close([replace(one, is_doubtful=True)])
    assert graph.poses == pytest.approx(before)
    graph.close([replace(other, is_doubtful=True)])
    assert graph.poses == pytest.approx(truth, abs=0.3)
    assert len(graph.loops) == 2


def test_a_local_map_fits_into_all_earlier_chunks_together():
    generator = np.random.default_rng(6)
    directions = generator.uniform(-np.pi, np.pi, 400)
    rays = np.column_stack((np.cos(directions), np.sin(directions)))
    room = rays * np.min(np.array([4.0, 3.4]) / np.abs(rays), axis=1)[:, None]
    third = np.digitize(directions, [-1.0, 1.0])
    seen = [replace(chunk_of(room[third == part]), travel=2.5 * part) for part in range(3)]
    graph = ChunkGraph(seen[0], np.zeros(3), MAPS)
    exact = np.diag(np.square([0.01, 0.01, 0.001]))
    for chunk in seen[1:]:
        graph.add(chunk, np.zeros((1, 3)), exact)
    # Odometry has brought the robot back to a place that is 0.6 m off.
    off = np.array([0.5, -0.3, 0.1])
    graph.add(blank_map(10), off[None], np.diag(np.square([0.3, 0.3, 0.1])))
    drawn = replace(chunk_of(room), travel=26.0)
    for chunk in seen:
        grid = search_grid(chunk.grid, MAPS.cell, 1.0)
        assert match(grid, drawn.points, off, Window(1.0, 0.3), 0.0).score < 0.5
    loop, pose = loop_to_joined(graph, drawn, np.zeros(3), exact)
    assert (loop.first in range(3), loop.second, loop.score > 0.8) == (True, 3, True)
    assert loop.relative == pytest.approx(np.zeros(3), abs=0.1)
    # What was believed counts, too.
    assert pose == pytest.approx(np.zeros(3), abs=0.2)
    # What was seen a moment ago is no earlier visit.
    latest = replace(drawn, travel=MAPS.another_visit - 0.1)
    assert loop_to_joined(graph, latest, np.zeros(3), exact) is None


def test_alignment_removes_what_moves_and_turns_all_positions():
    generator = np.random.default_rng(3)
    places = generator.normal(size=(40, 2)) * [6.0, 2.0]
    centred = places - places.mean(axis=0)
    rigid = np.column_stack(
        [np.tile([1.0, 0.0], 40), np.tile([0.0, 1.0], 40), centred[:, ::-1].ravel()]
    )
    rigid[0::2, 2] *= -1.0
    scattered = np.diag(generator.uniform(0.01, 0.02, 80))
    left = aligned_covariance(scattered + rigid @ np.diag([4.0, 1.0, 0.1]) @ rigid.T, places)
    assert left == pytest.approx(aligned_covariance(scattered, places), abs=1e-9)
    # Sampled positions have this error after alignment.
    samples = places + np.sqrt(np.diag(scattered)).reshape(40, 2) * generator.normal(
        size=(4000, 40, 2)
    )
    errors = []
    for sample in samples:
        turn = np.arctan2(
            *np.sum(
                [
                    [a * d - b * c, a * c + b * d]
                    for (a, b), (c, d) in zip(sample, centred, strict=True)
                ],
                axis=0,
            )
        )
        cos = np.cos(turn)
        sin = np.sin(turn)
        moved = (sample - sample.mean(axis=0)) @ np.array([[cos, sin], [-sin, cos]])
        errors.append(((moved - centred) ** 2).sum(axis=1).mean())
    assert np.mean(errors) == pytest.approx(np.trace(left) / 40.0, rel=0.02)
