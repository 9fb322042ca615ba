"""One file a schema: its name, the one before it, and how to come from that one."""
