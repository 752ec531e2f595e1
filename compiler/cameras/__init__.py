"""Places cameras and aims them, as matrices over the samples."""
