"""Stages as models for viewers and for other formats."""
