"""The conformance suite for a backend: its class, and what it lacks, each with the reason."""

from scenec_embree import Embree

from scenec.backends.testing import Conformance, Lacks

DULL = Lacks("surfaces are dull")
TOLERANCES = {
    "maps": Lacks("no maps"),
    "cutouts": Lacks("no maps"),
    "projections": Lacks("no maps"),
    "facets_under_a_sky": Lacks("no maps"),
    "gloss": DULL,
    "laws": DULL,
    "laws_under_a_sky": DULL,
    "metals_under_a_sky": DULL,
    "lamps": Lacks("no lamps"),
    "lamp_shadows": Lacks("no lamps"),
    "half_shadow": Lacks("no lamps"),
    "glow": Lacks("what gives off light is black"),
    "gobos": Lacks("no light filters"),
    "sheets": Lacks("sheets are opaque"),
    "sheet_furnace": Lacks("sheets are opaque"),
}


class TestEmbree(Conformance):
    """All checks of the suite."""

    backend = Embree
    tolerances = TOLERANCES
