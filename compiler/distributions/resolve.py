"""Replaces the distributions of a cfg by numbers drawn from them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Distribution, draw_number
from scenec.compiler.distributions.streams import Streams


def resolve(node: Any, streams: Streams, path: str, sample: int | None = None) -> Any:
    """A part of a cfg with its distributions drawn.

    A number that is drawn once a batch comes from the stream of its path, whatever the sample; one
    that is drawn once a sample from that of its path and the sample. What cannot be drawn here is
    left as the ``Distribution`` it is: numbers of each instance always, numbers of each sample
    where ``sample`` is None.

    Args:
        node: Part of ``Spec.cfg``: a dict, list or number.
        path: Where the part stands in the cfg, such as "light/sun": keys and list indices.

    Returns:
        A copy of the part.
    """
    if isinstance(node, dict):
        return {
            key: resolve(value, streams, f"{path}/{key}", sample) for key, value in node.items()
        }
    if isinstance(node, list | tuple):
        return [resolve(value, streams, f"{path}/{i}", sample) for i, value in enumerate(node)]
    if not isinstance(node, Distribution):
        return node
    if node.per == "batch":
        return draw_number(node, streams, path)
    if node.per == "sample" and sample is not None:
        return draw_number(node, streams, path, sample=sample)
    return node


def per_sample(node: Any, streams: Streams, path: str, samples: int) -> NDArray[np.float64]:
    """A number, or a list of numbers, at every sample: float64 [samples, ...]."""
    return np.array([resolve(node, streams, path, sample=i) for i in range(samples)], np.float64)
