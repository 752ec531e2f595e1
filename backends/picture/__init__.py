"""Composes pictures: half buffers, sky, haze, tiles, adaptive sampling, sub-frames, exposure."""
