"""Robots' own programs and logs, read as lists of poses or joint values: see kinds for the table of them."""

from armsight.store.programs.kinds import PROGRAMS, ProgramKind, kind_of, program_table, pulse_table
from armsight.store.programs.points import Listed
