"""One HTML page to look at all frames of an output: no server, no network, lazy."""
