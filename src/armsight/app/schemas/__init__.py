"""What commands tell programs: one model per command, the same for --json, the *.json files and `to_dict()`."""
