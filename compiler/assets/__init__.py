"""What comes in from files made elsewhere: triangle meshes in the formats of the field."""
