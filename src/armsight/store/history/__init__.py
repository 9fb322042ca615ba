"""The history of cells: a database of what calibrations, identifications and verifications found, run by run.

Importing it needs the packages of the extra `history`; the rest of armsight does without.
"""
