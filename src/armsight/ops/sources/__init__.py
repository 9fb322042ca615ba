"""Where frames come from, by the names that the command line takes."""
