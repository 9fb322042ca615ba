"""Korayem et al. 2018: the converged rig in sensor coordinates, and the rotary base under a rig."""
