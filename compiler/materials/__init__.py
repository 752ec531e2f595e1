"""Makes materials: pictures of rock and ground that need no files, baked and reduced pictures."""
