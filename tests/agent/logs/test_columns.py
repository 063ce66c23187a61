"""Names of columns: what each holds, its unit, and where a range points."""

import pytest

from limslam_agent.logs.columns import Role, column_of


@pytest.mark.parametrize(
    "case",
    [
        "t -> t",
        "Time (s) -> t s",
        "millis -> t ms",
        "timeMs -> t ms",
        "time_us -> t us",
        "t [µs] -> t us",
        "host_time_s -> t s",
        "%time -> t",
        "field.header.stamp -> t",
        "encL -> left",
        "ENC_LEFT -> left",
        "encoderleft -> left",
        "leftTicks -> left ticks",
        "right_ticks -> right ticks",
        "wheel right [mm] -> right mm",
        "left_m_s -> left m/s",
        "right_rpm -> right rpm",
        "left_rad_s -> left rad/s",
        "stateEstimate.x -> x",
        "field.pose.pose.position.y -> y",
        "odom_x [cm] -> x cm",
        "theta_deg -> theta deg",
        "odom_yaw -> theta",
        "stabilizer.yaw -> yaw",
        "BNO055_heading -> yaw",
        "yaw [°] -> yaw deg",
        "gz_dps -> gyro_z deg/s",
        "gyroZ -> gyro_z",
        "yaw_rate -> gyro_z",
        "field.twist.twist.linear.x -> v",
        "v -> v",
        "omega -> omega",
        "field.twist.twist.angular.z -> omega",
        "distance [mm] -> distance mm",
        "angle_deg -> angle deg",
        "field.pose.pose.orientation.w -> qw",
    ],
)
def test_a_name_says_what_was_measured_and_in_which_unit(case):
    name, meaning = case.split(" -> ")
    column = column_of(name)
    assert " ".join(filter(None, (column.role, column.unit))) == meaning
    assert column.name == name


@pytest.mark.parametrize(
    "case",
    [
        "r_-90 -> -90",
        "r[-45] -> -45",
        "R_90.0 -> 90",
        "range.15 -> 15",
        "range.-22.5 -> -22.5",
        "r_90_mm -> 90 mm",
        "range_-90 [mm] -> -90 mm",
        "range_m45deg -> -45",
        "r_left -> 90",
        "r_r -> -90",
        "dist_front -> 0",
        "tof_left_mm -> 90 mm",
        "tofFrontLeft -> 45",
        "tof_fr2_cm -> -45 cm",
        "us_front -> 0",
        "left_us -> 90",
        "ir_right_45 -> -45",
        "range.back -> 180",
        "VL53L0X_left -> 90",
        "front -> 0",
        "sonar1 -> 1",
        "left45 -> 45",
        "right_30_mm -> -30 mm",
        "range90deg -> 90",
        "ir-45deg -> -45",
    ],
)
def test_a_range_says_where_it_points(case):
    name, meaning = case.split(" -> ")
    column = column_of(name)
    assert column.role is Role.RANGE
    assert " ".join(filter(None, (f"{column.degrees:g}", column.unit))) == meaning


def test_a_range_may_say_no_direction():
    column = column_of("r_somewhere")
    assert (column.role, column.degrees) == (Role.RANGE, None)


@pytest.mark.parametrize(
    "name",
    [
        "battery",
        "motor_left_pwm",
        "cmd_left",
        "true_x",
        "range.up",
        "range.zrange",
        "stateEstimate.z",
        "gyro_x",
        "acc_x",
        "stabilizer.roll",
        "field.header.seq",
        "temp_left",
        "dt",
        "loop_time_us",
    ],
)
def test_what_means_nothing_here_has_no_role(name):
    assert column_of(name).role is None


def test_a_mark_before_a_name_says_that_it_counts_the_other_way():
    assert (column_of("-right").role, column_of("-right").sign) == (Role.RIGHT, -1.0)
    assert (column_of("-yaw_deg").unit, column_of("-yaw_deg").sign) == ("deg", -1.0)
    assert column_of("right").sign == 1.0
    assert column_of("").role is None
