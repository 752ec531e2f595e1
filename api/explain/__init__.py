"""What a compilation made, left out and erred: of a batch, or of one thing in it."""
