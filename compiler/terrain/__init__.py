"""Makes relief: a program of operators over a height field.

Each operator is one module: a frozen dataclass with a method ``apply``, whose fields are its keys
in the cfg, or what those draw.
"""
