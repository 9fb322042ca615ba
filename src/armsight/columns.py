"""Names of numbers that several tables have for columns and covariances for rows."""

POSITION = ("x_m", "y_m", "z_m")
ROTATION_VECTOR = ("rx_rad", "ry_rad", "rz_rad")
QUATERNION = ("qx", "qy", "qz", "qw")
POSE6 = (*POSITION, *ROTATION_VECTOR)
"""Of a pose's error or covariance: translation (m), then rotation vector (rad), in the parent's axes."""
POSE7 = (*POSITION, *QUATERNION)
"""Of a pose in its parent frame: m, and a quaternion with its scalar last."""
POSE6_STD = tuple(f"s{name}" for name in POSE6)
DH_ROW = ("a_m", "alpha_rad", "d_m", "theta_rad", "beta_rad")
"""Of a joint: Denavit and Hartenberg's four and Hayati's."""
STEREO_PIXELS = ("left_u_px", "left_v_px", "right_u_px", "right_v_px")
