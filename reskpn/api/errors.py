"""The root of everything that this package raises on purpose."""

from common.errors import ReskpnError

__all__ = ["ReskpnError"]
