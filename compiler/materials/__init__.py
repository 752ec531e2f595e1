"""Pictures of surfaces made by the compiler: rock and ground that need no files."""
