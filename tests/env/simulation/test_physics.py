"""Physics: exact arcs in the open, and bodies that neither enter walls nor each other."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_env import NoiseConfig, RobotSpec, load_world
from limslam_env.geometry import FloatArray, se2, segment
from limslam_env.simulation.physics import Physics
from limslam_env.simulation.simulation import Simulation

# TOP is the wheel travel of one step, m
RADIUS = 0.10
AXLE = 0.16
PERIOD = 0.1
TOP = 0.03
DEEPEST = 1e-3


def ring(corners: list[tuple[float, float]]) -> FloatArray:
    return segment.polygon_edges(np.array(corners))


BOX = ring([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])
# Corners of 17 and of 73 degrees: pushing out of one wall pushes into the other.
WEDGE = ring([(0.0, 0.0), (2.0, 0.0), (2.0, 0.6)])
CELL = ring([(0.0, 0.0), (0.8, 0.0), (0.8, 0.8), (0.0, 0.8)])


def physics(
    edges: FloatArray, *poses: tuple[float, float, float], radius: float = RADIUS
) -> Physics:
    model = Physics(edges, radius, len(poses))
    model.place(np.array(poses, dtype=float), AXLE)
    return model


def drive(model: Physics, left: float, right: float, steps: int) -> np.ndarray:
    """All robots alike; whether each of them touched something, step by step."""
    robots = len(model.poses)
    return np.array([model.step([(left, right)] * robots, PERIOD) for _ in range(steps)])


def depth_in_walls(poses: FloatArray, edges: FloatArray) -> float:
    return RADIUS - float(segment.distances(poses[:, :2], edges).min())


def overlap(poses: FloatArray) -> float:
    gaps = [np.hypot(*(a - b)) for number, a in enumerate(poses[:, :2]) for b in poses[:number, :2]]
    return 2.0 * RADIUS - min(gaps)


def random_actions(seed: int, robots: int, steps: int, hold: int = 20):
    """Wheel travel that mostly pushes on, so that walls and robots are leant on for a while."""
    generator = np.random.default_rng(seed)
    for step in range(steps):
        if step % hold == 0:
            action = generator.uniform(-1.0, 1.0, (robots, 2)) + generator.choice(
                [-1, 0, 1], (robots, 1)
            )
        yield (np.clip(action, -1.0, 1.0) * TOP).tolist()


def test_without_contact_the_pose_follows_the_exact_arcs():
    model = physics(BOX * 100.0, (200.0, 200.0, 0.4))
    expected = model.poses[0]
    generator = np.random.default_rng(0)
    for travel in generator.uniform(-TOP, TOP, (3000, 2)):
        contact = model.step([travel.tolist()], PERIOD)
        expected = se2.compose(expected, se2.arc(*se2.wheels_to_arc(travel, AXLE)))
        assert contact == [False]
        difference = model.poses[0] - expected
        assert np.abs(difference[:2]).max() < 1e-9
        assert abs(se2.wrap_angle(difference[2])) < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["forwards", "backwards"])
@pytest.mark.parametrize("quarter", range(4))
def test_driving_head_on_into_a_wall_stops_there(quarter, sign):
    heading = quarter * math.pi / 2
    model = physics(BOX, (2.0, 2.0, heading))
    contact = drive(model, sign * TOP, sign * TOP, 90)
    stop = 2.0 + sign * 1.9 * np.array([math.cos(heading), math.sin(heading)])
    np.testing.assert_allclose(model.poses[0, :2], stop, atol=DEEPEST)
    assert not contact[:60].any(), "1.8 m of 1.9 m are free"
    assert contact[65:].all()


def test_an_oblique_wall_contact_slides_along_the_wall():
    model = physics(BOX, (1.0, 0.2, -math.pi / 4))
    drive(model, TOP, TOP, 10)
    before = model.poses[0]
    contact = drive(model, TOP, TOP, 40)
    after = model.poses[0]
    assert contact.all()
    assert after[1] == pytest.approx(RADIUS, abs=DEEPEST)
    assert after[0] - before[0] == pytest.approx(40 * TOP * math.cos(math.pi / 4), rel=1e-3)
    assert after[2] == pytest.approx(-math.pi / 4)


def test_a_robot_in_contact_turns_on_the_spot():
    model = physics(BOX, (2.0, RADIUS, -math.pi / 2))
    drive(model, TOP, TOP, 3)
    before = model.poses[0]
    contact = drive(model, -TOP / 2, TOP / 2, 7)
    after = model.poses[0]
    assert contact.all()
    np.testing.assert_allclose(after[:2], before[:2], atol=1e-6)
    assert se2.wrap_angle(after[2] - before[2]) == pytest.approx(7 * TOP / AXLE, abs=1e-9)


@pytest.mark.parametrize(
    ("edges", "start"),
    [
        (load_world("env1").edges, (1.2, 2.0, 0.0)),
        (load_world("square").edges, (1.0, 1.0, 0.0)),
        (WEDGE, (1.6, 0.2, math.pi)),
        (CELL, (0.4, 0.4, 0.0)),
    ],
    ids=["env1", "square", "wedge", "cell"],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_random_walk_never_enters_a_wall_nor_leaves(edges, start, seed):
    model = physics(edges, start)
    touched = False
    corners = edges.reshape(-1, 2)
    outline = WEDGE[:, :2] if edges is WEDGE else ring_of(corners)
    for travel in random_actions(seed, 1, 1500, hold=40):
        touched |= model.step(travel, PERIOD)[0]
        assert depth_in_walls(model.poses, edges) < DEEPEST
        assert segment.inside_polygon(model.poses[:, :2], outline)[0]
    assert touched, "a walk that touches nothing shows nothing"


def ring_of(corners: FloatArray) -> FloatArray:
    (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
    return np.array([[left, low], [right, low], [right, high], [left, high]])


@given(
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=1, max_size=8),
    st.floats(-3.2, 3.2),
)
@settings(deadline=None, max_examples=60)
def test_no_sequence_of_pushes_gets_deep_into_a_wedge(actions, heading):
    model = physics(WEDGE, (1.8, 0.25, heading))
    for action in actions:
        for _ in range(25):
            model.step([(TOP * action[0], TOP * action[1])], PERIOD)
            assert depth_in_walls(model.poses, WEDGE) < DEEPEST


@pytest.mark.parametrize("speed", [0.9, 3.0])
def test_a_fast_robot_does_not_pass_through_a_wall(speed):
    # Nothing keeps a RobotSpec from moving further in a step than the body is wide.
    for start in (2.0, 2.017, 2.05, 2.1):
        model = physics(BOX, (start, 2.0, 0.0))
        contact = drive(model, speed * PERIOD, speed * PERIOD, 100)
        assert model.poses[0, 0] == pytest.approx(4.0 - RADIUS, abs=DEEPEST)
        assert contact[-1].all()


@pytest.mark.parametrize(
    ("edges", "starts"),
    [
        (BOX, [(1.0, 1.0, 0.0), (1.5, 1.0, math.pi)]),
        (CELL, [(0.2, 0.2, 0.0), (0.5, 0.2, 1.0), (0.5, 0.5, 2.0), (0.2, 0.5, 0.0)]),
        (load_world("env1").edges, [(1.2, 2.0, 0.0), (1.5, 2.0, math.pi), (1.2, 1.7, 1.0)]),
    ],
    ids=["box", "four in a cell", "env1"],
)
@pytest.mark.parametrize("seed", range(2))
def test_robots_never_overlap_nor_enter_walls(edges, starts, seed):
    model = physics(edges, *starts)
    touched = False
    for travel in random_actions(seed, len(starts), 1500):
        touched |= any(model.step(travel, PERIOD))
        assert overlap(model.poses) < DEEPEST
        assert depth_in_walls(model.poses, edges) < DEEPEST
    assert touched


@pytest.mark.parametrize("seed", [3, 16, 58])
def test_robots_that_push_each_other_into_a_wedge_do_not_overlap(seed):
    # Wedged, a robot cannot give way: what is done about the walls must not be at the other robot's
    # cost.
    model = physics(WEDGE, (1.6, 0.2, math.pi), (1.85, 0.2, math.pi))
    for travel in random_actions(seed, 2, 1500):
        model.step(travel, PERIOD)
        assert overlap(model.poses) < DEEPEST
        assert depth_in_walls(model.poses, WEDGE) < DEEPEST
        assert segment.inside_polygon(model.poses[:, :2], WEDGE[:, :2]).all()


@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_fast_robots_do_not_pass_through_each_other(speed):
    for start in (2.5, 2.55, 2.613, 2.7):
        model = physics(BOX, (1.0, 2.0, 0.0), (start, 2.0, math.pi))
        contact = drive(model, speed * PERIOD, speed * PERIOD, 40)
        assert contact[-1].all()
        assert model.poses[0, 0] < model.poses[1, 0]
        assert -1e-4 < overlap(model.poses) < DEEPEST


@pytest.mark.parametrize(("robots", "speed"), [(1, 0.3), (3, 2.0)], ids=["usual", "fast"])
def test_the_compiled_step_moves_robots_as_the_physics_does(robots, speed):
    robot = RobotSpec(max_wheel_speed=speed)
    world = load_world("env3")
    simulation = Simulation(world, robot, robots)
    physics = Physics(world.edges, robot.radius, robots)
    physics.place(simulation.reset(np.random.SeedSequence(1), NoiseConfig())[1].poses, robot.axle)
    generator = np.random.default_rng(2)
    touches = 0
    for step in range(600):
        if step % 20 == 0:
            actions = generator.uniform(-0.2, 1.0, (robots, 2))
        truth = simulation.step(actions.tolist())[1]
        travel = actions * (speed * robot.control_period)
        assert truth.contact == physics.step(travel.tolist(), robot.control_period)
        np.testing.assert_array_equal(truth.poses, physics.poses)
        touches += sum(truth.contact)
    assert 0 < touches < 600 * robots
