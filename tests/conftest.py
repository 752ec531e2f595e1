"""What holds for all tests."""

from __future__ import annotations

import os

# No test reads or fills the user's cache; those of the cache name a folder of their own.
os.environ["SCENEC_CACHE"] = ""
