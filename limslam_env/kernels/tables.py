"""Columns of the tables of beams and of noise that kernels read."""

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, _, _, ANGLE, LONGEST_RANGE, OFFSET, SHORTEST_RANGE, PERIOD = range(11)
"""Columns of a table of beams (n_beams, 11), of which the first are those of ``RobotSpec.beam_table``: origin (m) and
direction as a unit vector in the robot's frame, angle (rad), longest reading (m), how far before its origin a ray
starts (m), shortest reading (m), and period in steps."""

RANGE_STD, STD_GROWTH, DROPOUT, RANGE_RESOLUTION, FOLD_BACK, CONE = range(6)
"""Columns of a table of noise for the range sensors: what :func:`~limslam_env.kernels.readings.noisy_reading` needs,
and half the opening angle of the beams, rad."""

LEFT_WHEEL, RIGHT_WHEEL, WHEEL_VARIANCE, ENCODER_RESOLUTION, LARGEST_TRAVEL = range(6, 11)
"""Columns of the same table for the encoders: the factor of each wheel, and what follows it in
:func:`~limslam_env.kernels.readings.reported_travel`."""

SLIP_RATE, SLIP_SHARE, TRUE_AXLE = range(11, 14)
"""Further columns: slips per metre, the share of the travel that a slip takes, and the true distance between
the wheels, m."""

NUM_NOISES = 14
"""Number of columns of the table of noise."""
