"""From a USD stage to annotated frames: the reader, the renderers, the resolver.

Nothing here knows of a cfg; the stage on disk is all a backend sees.
"""
