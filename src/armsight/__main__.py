"""python -m armsight: the command line."""

from armsight.cli import main

main()
