"""Computes suns and skies: directions, lat-long pictures, irradiance."""
