"""The command line: parse, call one app function, print."""

import os


def main() -> None:
    """Run the command line.

    Linear algebra keeps to one thread, where the user's own OPENBLAS_NUM_THREADS does not say otherwise: our matrices
    are small, and OpenBLAS's threads wait for each other by spinning, on a busy machine longer than they work.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported
    from armsight.cli.commands import app  # imported here so that `import armsight.cli` costs nothing

    app(prog_name="armsight")
