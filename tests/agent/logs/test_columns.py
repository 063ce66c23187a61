"""Names of columns: what each holds, its unit, and where a range points."""

import pytest

from limslam_agent.logs.columns import Role, column_of


@pytest.mark.parametrize(
    ("name", "role", "unit"),
    [
        ("t", Role.TIME, None),
        ("Time (s)", Role.TIME, "s"),
        ("millis", Role.TIME, "ms"),
        ("timeMs", Role.TIME, "ms"),
        ("time_us", Role.TIME, "us"),
        ("t [µs]", Role.TIME, "us"),
        ("host_time_s", Role.TIME, "s"),
        ("%time", Role.TIME, None),
        ("field.header.stamp", Role.TIME, None),
        ("encL", Role.LEFT, None),
        ("ENC_LEFT", Role.LEFT, None),
        ("encoderleft", Role.LEFT, None),
        ("leftTicks", Role.LEFT, "ticks"),
        ("right_ticks", Role.RIGHT, "ticks"),
        ("wheel right [mm]", Role.RIGHT, "mm"),
        ("left_m_s", Role.LEFT, "m/s"),
        ("right_rpm", Role.RIGHT, "rpm"),
        ("left_rad_s", Role.LEFT, "rad/s"),
        ("stateEstimate.x", Role.X, None),
        ("field.pose.pose.position.y", Role.Y, None),
        ("odom_x [cm]", Role.X, "cm"),
        ("theta_deg", Role.HEADING, "deg"),
        ("odom_yaw", Role.HEADING, None),
        ("stabilizer.yaw", Role.YAW, None),
        ("BNO055_heading", Role.YAW, None),
        ("yaw [°]", Role.YAW, "deg"),
        ("gz_dps", Role.YAW_RATE, "deg/s"),
        ("gyroZ", Role.YAW_RATE, None),
        ("yaw_rate", Role.YAW_RATE, None),
        ("field.twist.twist.linear.x", Role.SPEED, None),
        ("v", Role.SPEED, None),
        ("omega", Role.TURN_RATE, None),
        ("field.twist.twist.angular.z", Role.TURN_RATE, None),
        ("distance [mm]", Role.DISTANCE, "mm"),
        ("angle_deg", Role.ANGLE, "deg"),
        ("field.pose.pose.orientation.w", Role.QW, None),
    ],
)
def test_a_name_says_what_was_measured_and_in_which_unit(name, role, unit):
    column = column_of(name)
    assert (column.role, column.unit) == (role, unit)
    assert column.name == name


@pytest.mark.parametrize(
    ("name", "degrees", "unit"),
    [
        ("r_-90", -90.0, None),
        ("r[-45]", -45.0, None),
        ("R_90.0", 90.0, None),
        ("range.15", 15.0, None),
        ("range.-22.5", -22.5, None),
        ("r_90_mm", 90.0, "mm"),
        ("range_-90 [mm]", -90.0, "mm"),
        ("range_m45deg", -45.0, None),
        ("r_left", 90.0, None),
        ("r_r", -90.0, None),
        ("dist_front", 0.0, None),
        ("tof_left_mm", 90.0, "mm"),
        ("tofFrontLeft", 45.0, None),
        ("tof_fr2_cm", -45.0, "cm"),
        ("us_front", 0.0, None),
        ("left_us", 90.0, None),
        ("ir_right_45", -45.0, None),
        ("range.back", 180.0, None),
        ("VL53L0X_left", 90.0, None),
        ("front", 0.0, None),
        ("sonar1", 1.0, None),
        ("r_somewhere", None, None),
    ],
)
def test_a_range_says_where_it_points(name, degrees, unit):
    column = column_of(name)
    assert (column.role, column.degrees, column.unit) == (Role.RANGE, degrees, unit)


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
        "",
    ],
)
def test_what_means_nothing_here_has_no_role(name):
    assert column_of(name).role is None


def test_a_mark_before_a_name_says_that_it_counts_the_other_way():
    assert (column_of("-right").role, column_of("-right").sign) == (Role.RIGHT, -1.0)
    assert (column_of("-yaw_deg").unit, column_of("-yaw_deg").sign) == ("deg", -1.0)
    assert column_of("right").sign == 1.0


@pytest.mark.parametrize(
    ("name", "degrees"),
    [("left45", 45.0), ("right_30_mm", -30.0), ("range90deg", 90.0), ("ir-45deg", -45.0)],
)
def test_degrees_behind_a_word_are_the_direction(name, degrees):
    assert column_of(name).role is Role.RANGE
    assert column_of(name).degrees == degrees
