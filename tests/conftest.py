"""What holds for all tests."""

from __future__ import annotations

import os

# No test reads or fills the user's cache; those of the cache name a folder of their own.
os.environ["SCENEC_CACHE"] = ""
# Threads of kernels sleep while they wait for one another: where several test processes share few
# cores, those that spin (the default) keep busy the core that the other thread needs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
