"""What a batch is made of: the Plan (every number drawn), the Scene (arrays), their vocabulary."""
