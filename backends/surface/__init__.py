"""Defines the materials of surfaces, as far as renderers share them."""
