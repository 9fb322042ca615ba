"""Emulated controllers, each with its own code for the protocol its driver speaks."""
