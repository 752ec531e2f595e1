"""Is an output sound: its files, its stages, its frames, and do backends agree on it."""
