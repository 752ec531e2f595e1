"""Relief operators: each a frozen dataclass of plain numbers with a method ``apply``."""
