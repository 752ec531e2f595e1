"""Spec and seed to Plan: all drawing, and nothing random after it."""
