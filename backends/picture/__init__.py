"""What pictures are composed of: halves, sky, haze, tiles, rounds, sub-frames, exposure."""
