"""How kinds of things are declared, and how a cfg is walked along what they declare."""
