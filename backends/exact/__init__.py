"""The exact ray caster, and what is made of its answers: what annotation is defined by.

``intersect`` defines a hit; ``build`` and ``bvh`` hold the candidates for it, ``trace`` walks them
and ``caster`` is the face of these; ``annotate`` computes depth, labels and the rest.
"""

from scenec.backends.exact.caster import ExactCaster, Hits

__all__ = ["ExactCaster", "Hits"]
