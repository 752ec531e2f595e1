"""From a cfg and a seed to USD stages: front end, scene building, passes, emitter.

Deterministic to the byte; imports no backend.
"""
