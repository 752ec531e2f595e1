"""Simulates a real camera on rendered radiance: optics, electrons, numbers, a picture."""
