"""The front end: from a cfg file to a validated Spec, and with a seed to plain numbers."""
