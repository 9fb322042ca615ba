"""A path is taught by leading the target along it: the person's command round control.teach."""
