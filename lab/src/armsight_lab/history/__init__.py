"""The history of cells: what calibrations and verifications found, filed in a database, and judged for drift.

`database`, `queries` and `tables` need the packages of the extra `history`.
"""
