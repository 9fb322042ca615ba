"""A path is run with the tool's tip: the person's command round control.play."""
