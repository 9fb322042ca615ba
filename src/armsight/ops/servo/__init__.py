"""The arm follows a target that cameras see: the person's command round control.servo."""
