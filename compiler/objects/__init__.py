"""Makes objects, scattered and single ones: shapes, places, seats, levels of detail."""
