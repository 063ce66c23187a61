"""The robot's description: beams find their sides, arrays stay as they are, and nonsense is refused."""

import math
import re

import pytest

from limslam_env import RobotSpec, SensorSpec
from limslam_env.interface import beams_on_rim, side_of


@pytest.mark.parametrize(
    ("degrees", "side"),
    [
        (15, "none"),
        (45, "left"),
        (180, "none"),
        (-45, "right"),
        (270, "right"),
    ],
)
def test_a_beam_without_a_side_gets_that_of_its_angle(degrees, side):
    angle = math.radians(degrees)
    assert SensorSpec(0.0, 0.0, angle).side == side_of(angle) == side
    assert SensorSpec(0.0, 0.0, angle, side=None).side == side
    assert beams_on_rim((degrees,), 0.1)[0].side == side


@pytest.mark.parametrize("side", ["Left", 1])
def test_an_unknown_side_is_refused(side):
    with pytest.raises(ValueError, match="side is left, right or none"):
        SensorSpec(0.0, 0.0, 0.0, side=side)


def test_brackets_in_a_file_that_are_never_closed_are_refused():
    with pytest.raises(ValueError, match="not a robot"):
        RobotSpec.from_json("[" * 100_000)


def test_beams_given_as_a_list_are_as_good_as_a_tuple():
    beams = list(beams_on_rim((90.0, 0.0, -90.0), 0.1))
    robot = RobotSpec(beams=beams)
    assert robot.beams == tuple(beams)
    assert robot == RobotSpec(beams=tuple(beams))
    assert hash(robot) == hash(RobotSpec(beams=tuple(beams)))
    # What becomes of the list afterwards is none of the robot's business.
    beams.clear()
    assert len(robot.beams) == 3
    assert RobotSpec.from_json(robot.to_json()) == robot
    with pytest.raises(ValueError, match="at least one beam"):
        RobotSpec(beams=[])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"radius": 60.0}, "a robot's radius is at most 5 m, not 60: is it in m?"),
        ({"axle": 115.0}, "a robot's axle is at most 10 m, not 115: is it in m?"),
        ({"max_wheel_speed": 300.0}, "a robot's max_wheel_speed is at most 100 m/s, not 300: is it in m/s?"),
    ],
)
def test_a_robot_in_millimetres_is_refused(wrong, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        RobotSpec(**wrong)


@pytest.mark.parametrize("wrong", [{"max_range": 2000.0}, {"x": 60.0}, {"y": -30.0}])
def test_a_beam_in_millimetres_is_refused(wrong):
    with pytest.raises(ValueError, match="a beam's place and max_range must be metres"):
        SensorSpec(**{"x": 0.0, "y": 0.0, "angle": 0.0, **wrong})


def test_the_largest_robots_and_beams_are_accepted():
    beams = (SensorSpec(5.0, -5.0, 0.0, max_range=1000.0),)
    assert RobotSpec(radius=5.0, axle=10.0, max_wheel_speed=100.0, beams=beams).reach > 1000.0


@pytest.mark.parametrize("wrong", [[90.0, -90.0], ["left"], [{"x": 0.0}], [None]])
def test_beams_that_are_no_sensors_are_refused(wrong):
    with pytest.raises(TypeError, match="each beam of a robot must be a SensorSpec, as beams_on_rim makes them"):
        RobotSpec(beams=wrong)


@pytest.mark.parametrize(
    "degrees",
    [(math.pi / 2, 0.0, -math.pi / 2), (math.radians(54.0),)],
)
def test_radians_where_degrees_are_expected_are_refused(degrees):
    with pytest.raises(ValueError, match=r"the angles of beams_on_rim are degrees, but .* look like radians"):
        beams_on_rim(degrees, 0.1)


def test_degrees_where_radians_are_expected_are_refused():
    with pytest.raises(ValueError, match=r"a beam's angle is within 4 pi rad, not 90: is it in rad\?"):
        SensorSpec(0.05, 0.0, 90.0)


@pytest.mark.parametrize("degrees", [(1, -1), (6, 0), (1.57, 90.0), ()])
def test_small_angles_in_degrees_are_accepted(degrees):
    assert len(beams_on_rim(degrees, 0.1)) == len(degrees)
