"""Computes coherent noise: functions of position and a 64-bit key, with no state."""
