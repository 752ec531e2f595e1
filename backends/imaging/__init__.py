"""What a real camera does to radiance, after rendering: optics, electrons, numbers, a picture."""
