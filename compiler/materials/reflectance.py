"""Declares how the dull part of a surface scatters light, where it is not Lambert's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.kinds import Context, bounded, forms, key
from scenec.compiler.scene.material import Reflectance

_B = bounded(forms.PER_BATCH, at_least=0, at_most=0.9).but(
    description="How pointed the lobes of a grain's phase function are (double Henyey-Greenstein, "
    "Hapke 2012, eq. 6.7a)."
)
_C = bounded(forms.PER_BATCH, at_least=-1, at_most=1).but(
    description="Which way a grain scatters: 1 back to the light, -1 forth. Hapke's relation to b: "
    "c = 3.29 exp(-17.4 b^2) - 0.908."
)
_OPPOSITION = bounded(forms.PER_BATCH, at_least=0, at_most=3).but(
    description="B0: how much brighter grains are with the light behind the viewer, where they "
    "hide their shadows."
)
_OPPOSITION_WIDTH = bounded(forms.PER_BATCH, at_least=0.002, at_most=0.5).but(
    description="h: that rise has fallen to half at a phase angle of 2 arctan(h)."
)


@dataclass(frozen=True, kw_only=True)
class Lambert:
    """The same brightness from everywhere."""

    EXAMPLE: ClassVar = {"type": "lambert"}

    def draw(self, context: Context) -> None:
        """Nothing: materials without a reflectance scatter so."""


@dataclass(frozen=True, kw_only=True)
class LommelSeeliger:
    """Lommel and Seeliger's law, of dark grains that scatter light once: w/(4 pi (mu0 + mu)) P(g)
    (1 + B(g)), with w = 4 r0/(1 + r0)^2 of the color r0. Left out, P is 1 and B 0: the classic law.
    """

    EXAMPLE: ClassVar = {"type": "lommel_seeliger", "opposition": 1, "opposition_width": 0.05}
    TITLE: ClassVar = "Reflectance: lommel_seeliger"

    b: float = key(_B, default=0)
    c: float = key(_C, default=0)
    opposition: float = key(_OPPOSITION, default=0)
    opposition_width: float = key(_OPPOSITION_WIDTH, default=0.06)

    def draw(self, context: Context) -> Reflectance:
        """The law, of grains on level ground."""
        return Reflectance("lommel_seeliger", **vars(self))


@dataclass(frozen=True, kw_only=True)
class Hapke:
    """Hapke's law (2012), of ground of rough grains, with the opposition surge.

    The color is r0, the diffusive reflectance, and w = 4 r0/(1 + r0)^2 the grains' albedo. Left
    out, the numbers are those of Mare Tranquillitatis at 643 nm (Sato et al. 2014, the map's
    cell of Tranquility Base, where w is 0.222: a color of 0.063). Mars, Meridiani Planum at 800
    nm (CRISM over the Opportunity rover, AGU 2010, P51D-1469): b 0.26, c 1, w 0.47, a color of
    0.16.
    """

    EXAMPLE: ClassVar = {"type": "hapke", "roughness_deg": 15}

    b: float = key(_B, default=0.254)
    c: float = key(_C, default=0.16)
    opposition: float = key(_OPPOSITION, default=1.993)
    opposition_width: float = key(_OPPOSITION_WIDTH, default=0.06)
    roughness_deg: float = key(forms.ANGLE_PER_BATCH, default=23.657, at_least=0, at_most=60)
    """Mean slope of what is too small to be drawn (theta bar, Hapke 1984). Measured values hold for
    relief up to the size of the instrument's pixels: what the scene's relief and displacement draw
    themselves counts twice."""

    def draw(self, context: Context) -> Reflectance:
        """The law."""
        return Reflectance("hapke", **vars(self))
