"""``--backend auto``: the renderer that measured curves of error and time speak for."""

from scenec.backends.auto.choose import Choice, choose

__all__ = ["Choice", "choose"]
