"""USD stages to flat arrays: ``read.read_stage`` and what it needs; ``scene.RenderScene``."""
