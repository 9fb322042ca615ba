"""Typed settings; nothing below may read them."""
