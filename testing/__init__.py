"""What tests and the lab share: scenes, outputs, oracles, faults of files; not in the wheel."""
