"""Writes the Scene as USD: one small readable root layer, and sublayers it is composed of.

Every layer is authored in one fixed order with ``Usd.Stage.CreateNew`` and saved once: that is what
makes its bytes a function of the Scene alone.
"""
