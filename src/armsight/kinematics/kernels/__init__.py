"""Compiled kinematics. The arm travels as one table, see `armsight.kinematics.arm.Arm.chain`."""
