"""Robots for the person's commands: opening, testing, jogging, serving."""
