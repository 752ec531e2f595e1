"""Scene to USD: one small readable root layer, and sublayers for what it is composed of.

Every layer is authored in one fixed order with ``Usd.Stage.CreateNew`` and saved once: that is what
makes its bytes a function of the Scene alone.
"""
