"""From frames to what people look at and train on."""
