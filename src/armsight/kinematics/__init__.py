"""Joints <-> pose: chains, forward and inverse kinematics, Jacobians, singularities, tracks along paths."""

from armsight.kinematics.arm import Arm
from armsight.kinematics.axes import Link, dh_arm, link_to_line
from armsight.kinematics.closed_form import (
    Family,
    Wrist,
    family_of,
    near_singularities,
    singularity_distance,
    singularity_measures,
)
from armsight.kinematics.forward_kinematics import (
    fk,
    fk_jacobian,
    in_convention,
    jacobian,
    link_frames,
    moved,
    parameter_jacobian,
    parameter_names,
    pose,
)
from armsight.kinematics.inverse_kinematics import Inverse, Solution, Status, branch_names, ik, ik_many, singular_names
from armsight.kinematics.joints import Convention, Coupling, Joint, JointType, ToolPoint
from armsight.kinematics.numeric import (
    Attempt,
    Effort,
    Method,
    Stop,
    Task,
    Tolerance,
    solve_numeric,
    solve_numeric_many,
)
from armsight.kinematics.path import Issue, JointPath, Trouble, track_path
from armsight.kinematics.presets import PRESETS, preset, warm_up
