"""What developers run and nobody installs: benchmarks, measured pages, experiments, robustness."""
