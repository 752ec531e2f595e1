"""Suns and skies: directions, lat-long pictures, irradiance."""
