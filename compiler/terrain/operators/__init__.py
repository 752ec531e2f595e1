"""Shapes relief: each operator a frozen dataclass of plain numbers with a method ``apply``."""
