"""Declares what all parts of scenec share: cfg schema, stage names, frames, errors, file formats.

Every other package imports this one; it imports none of them.
"""
