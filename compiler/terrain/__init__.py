"""Makes relief: a program of operators over a height field.

Each operator is one module: a frozen dataclass of plain numbers with a method ``apply``. Its cfg
keys are the fields of the dataclass; its schema is ``schemas/cfg/relief_<type>.schema.json``.
"""
