"""Where cameras stand and look, as matrices over the samples."""
