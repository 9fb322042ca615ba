"""Names of a pose's numbers, as tables have them for columns and covariances for rows."""

POSITION = ("x_m", "y_m", "z_m")
ROTATION_VECTOR = ("rx_rad", "ry_rad", "rz_rad")
QUATERNION = ("qx", "qy", "qz", "qw")
POSE6 = (*POSITION, *ROTATION_VECTOR)
"""Of a pose's error or covariance."""
POSE7 = (*POSITION, *QUATERNION)
"""Of a pose."""
