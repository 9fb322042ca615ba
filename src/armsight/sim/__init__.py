"""The synthetic world. Shares no projection code with the product; reached by entry point."""
