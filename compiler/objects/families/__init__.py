"""Shapes kinds of rocks, each a radius over the directions from a point inside.

A surface that is a radius over directions cannot meet itself, whatever the radius: no two of its
points lie in the same direction.
"""
