"""Fixtures and contract suites for the users' own tests."""
