"""Reads what comes in from files made elsewhere: models, height fields, tracks, pictures."""
