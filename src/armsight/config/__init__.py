"""Typed settings; nothing below may read them."""

from armsight.config.settings import Settings, chosen, load_settings

__all__ = ["Settings", "chosen", "load_settings"]
