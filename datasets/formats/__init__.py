"""Dataset formats, one module each; ``contract`` says what a format is."""
