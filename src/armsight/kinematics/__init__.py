"""Joints <-> pose: chains, forward and inverse kinematics, Jacobians."""
