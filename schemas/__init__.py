"""What the parts of scenec agree on: cfg schema, stage names, frame contract, errors, file formats.

Every other package imports this one; it imports none of them.
"""
