"""Their commands, each an entry point of the group armsight.commands."""
