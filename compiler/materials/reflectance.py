"""Declares how the dull part of a surface scatters light, where it is not Lambert's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.kinds import Context, bounded, forms, key
from scenec.compiler.scene.material import Reflectance

_B = bounded(forms.PER_BATCH, at_least=0, at_most=0.9).but(
    description="How narrow the lobes of the phase function are (double Henyey-Greenstein, Hapke "
    "2012, eq. 6.7a)."
)
_C = bounded(forms.PER_BATCH, at_least=-1, at_most=1).but(
    description="Direction of scattering: 1 back to the light, -1 forward. Hapke's relation: c = "
    "3.29 exp(-17.4 b^2) - 0.908."
)
_OPPOSITION = bounded(forms.PER_BATCH, at_least=0, at_most=3).but(
    description="B0: how much brighter grains are with the light behind the viewer."
)
_OPPOSITION_WIDTH = bounded(forms.PER_BATCH, at_least=0.002, at_most=0.5).but(
    description="h: that rise halves at a phase angle of 2 arctan(h)."
)


@dataclass(frozen=True, kw_only=True)
class Lambert:
    """The same brightness from everywhere."""

    EXAMPLE: ClassVar = {"type": "lambert"}

    def draw(self, context: Context) -> None:
        """Nothing: materials without a reflectance scatter so."""


@dataclass(frozen=True, kw_only=True)
class LommelSeeliger:
    """Lommel and Seeliger's law, of dark grains that scatter once: w/(4 pi (mu0 + mu)) P(g) (1 +
    B(g)), w = 4 r0/(1 + r0)^2 of the color r0. By default P is 1 and B 0.
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
    """Hapke's law (2012), of rough grains, with opposition surge. The color is r0, the diffusive
    reflectance; the grains' albedo w is 4 r0/(1 + r0)^2. Defaults: Mare Tranquillitatis at 643 nm
    (Sato et al. 2014, Tranquility Base: w 0.222, color 0.063). Mars, Meridiani Planum at 800 nm
    (CRISM, AGU 2010, P51D-1469): b 0.26, c 1, w 0.47, color 0.16.
    """

    EXAMPLE: ClassVar = {"type": "hapke", "roughness_deg": 15}

    b: float = key(_B, default=0.254)
    c: float = key(_C, default=0.16)
    opposition: float = key(_OPPOSITION, default=1.993)
    opposition_width: float = key(_OPPOSITION_WIDTH, default=0.06)
    roughness_deg: float = key(forms.ANGLE_PER_BATCH, default=23.657, at_least=0, at_most=60)
    """Mean slope of relief too small to be drawn (theta bar, Hapke 1984). Measured values include
    relief up to the instrument's pixels, so relief and displacement of the scene count twice."""

    def draw(self, context: Context) -> Reflectance:
        """The law."""
        return Reflectance("hapke", **vars(self))
