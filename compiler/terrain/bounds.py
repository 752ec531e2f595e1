"""Checks the bounds of conditions on a place."""

from __future__ import annotations

from collections.abc import Iterator

from scenec.compiler.kinds import Finding, Node


class Bounds:
    """Checks the bounds of a condition: a smallest value, a largest one, or both."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a condition without bounds, and one whose bounds can exclude all."""
        low, high = (
            next((key for key in node.entries if key == end or key.startswith(f"{end}_")), None)
            for end in ("min", "max")
        )
        if low is None and high is None:
            yield node.fault("no bounds: expected a smallest value, a largest one, or both")
        elif low is not None and high is not None:
            least, most = node.span(low), node.span(high)
            if least and most and least[1] > most[0]:
                yield node.fault(
                    f"{least[1]:g} can be above {high} ({most[0]:g}): expected it below", low
                )
