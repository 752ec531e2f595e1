"""Objects dropped onto the ground by a physics library, aside from compiling."""
