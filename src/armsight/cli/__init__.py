"""The command line: parse, call one app function, print."""


def main() -> None:
    """Run the command line."""
    from armsight.cli.commands import app  # imported here so that `import armsight.cli` costs nothing

    app(prog_name="armsight")
