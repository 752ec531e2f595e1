"""Cfgs of OAISYS (Müller et al., IROS 2021): those of 2021, today's, and the paper's listings."""
