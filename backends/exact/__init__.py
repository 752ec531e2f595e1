"""The exact ray caster, and what is made of its answers: what annotation is defined by.

``intersect`` defines a hit; ``build`` and ``bvh`` hold the candidates for it, ``trace`` walks them
and ``caster`` is the face of these. ``settle`` makes a renderer's visibility exact, with ``twins``
to warn it of ties; ``annotate`` computes depth, labels and the rest.
"""

from scenec.backends.exact.caster import ExactCaster

__all__ = ["ExactCaster"]
