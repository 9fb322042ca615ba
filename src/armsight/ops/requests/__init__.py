"""What commands that are no actions are told: one frozen dataclass a request, from whose fields come the flags."""
