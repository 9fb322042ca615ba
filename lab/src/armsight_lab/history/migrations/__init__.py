"""The schemas of the history, oldest first: Alembic's files, shipped with the package."""
