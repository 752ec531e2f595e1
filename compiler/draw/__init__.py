"""Draws a Plan from a Spec and a seed; after that nothing is random.

Functions here take a part of the cfg (``cfg``; ``node`` once it is resolved), the batch's streams,
and the part's ``path`` in the cfg, which names the streams that it draws from.
"""
