"""Describes the atmospheres of Earth and Mars.

Both are spheres with two scatterers whose density falls exponentially with height, gas and aerosol
(Nishita et al. 1993, SIGGRAPH), and one absorber in a layer whose density rises and falls linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light.atmosphere_spectra import wavelengths


@dataclass(frozen=True)
class Planet:
    """A planet's size and the heights over which its atmosphere thins, meters.

    Attributes:
        radius_m: Of the ground.
        top_m: Height above which there is nothing.
        gas_m, aerosol_m: Heights over which densities fall by 1/e.
        layer_m, layer_half_m: Where the absorber is densest, and how far it reaches up and down.
    """

    radius_m: float
    top_m: float
    gas_m: float
    aerosol_m: float
    layer_m: float = 25_000.0
    layer_half_m: float = 15_000.0

    def sizes(self) -> NDArray[np.float64]:
        """Returns the lengths as the kernels take them, [6]."""
        return np.array(
            [self.radius_m, self.top_m, self.gas_m, self.aerosol_m, self.layer_m, self.layer_half_m]
        )


@dataclass(frozen=True)
class AirMedium:
    """Coefficients at the ground (of the absorber: in its densest height), by wavelength.

    Attributes:
        gas, aerosol: Scattering, 1/m, [wavelengths].
        aerosol_loss: Scattering and absorption of the aerosol.
        layer: Absorption of the layer.
        phase: Of the aerosol, [4, wavelengths]: share of the forward lobe, its g, the other's g,
            and 1 for a forward lobe of Cornette and Shanks, 0 for one of Henyey and Greenstein.
    """

    planet: Planet
    gas: NDArray[np.float64]
    aerosol: NDArray[np.float64]
    aerosol_loss: NDArray[np.float64]
    layer: NDArray[np.float64]
    phase: NDArray[np.float64]

    def spectra(self) -> NDArray[np.float64]:
        """Gas, aerosol, loss by the aerosol, absorption, as kernels take them, [4, wavelengths]."""
        return np.stack([self.gas, self.aerosol, self.aerosol_loss, self.layer])


#: Top: 1e-5 of the ground's density is left.
EARTH = Planet(radius_m=6_360_000.0, top_m=95_000.0, gas_m=8_000.0, aerosol_m=1_200.0)
MARS = Planet(radius_m=3_389_500.0, top_m=130_000.0, gas_m=11_100.0, aerosol_m=11_100.0)

#: Rayleigh's 8 pi^3 (n^2 - 1)^2 / (3 N lambda^4) of air with n = 1.0002926 and N = 2.504e25 / m^3,
#: without dispersion and depolarization, 1/m where lambda is in nm. With the scale height of 8 km
#: the vertical optical depth at 550 nm is 0.099; Bucholtz (1995, Appl. Opt. 34:2765) has 0.097.
_AIR = 1.1311490e6
#: Gray aerosol, 1/m, of which absorption takes 0.11 more (Nishita et al. 1993; Bruneton and Neyret
#: 2008, EGSR), with g of Cornette and Shanks (1992, Appl. Opt. 31:3152).
_AEROSOL, _AEROSOL_LOSS, _AEROSOL_G = 2e-5, 2.22e-5, 0.76
#: Absorption of ozone in 25 km, 1/m at 380, 400 ... 780 nm: cross sections (Serdyuchenko et al.
#: 2014, Atmos. Meas. Tech. 7:625) times the density that makes 300 Dobson units, as in Blender's
#: sky texture.
_OZONE = np.array(
    [3.25126849861e-9, 5.85395365047e-9, 1.977191155085e-8, 7.309568762914e-8, 2.0084561514287e-7,
     4.0383958096161e-7, 6.3551335912363e-7, 9.670704118097e-7, 1.5479740042441e-6,
     2.09038647223331e-6, 2.46128056164565e-6, 2.73551299461512e-6, 2.15125863128643e-6,
     1.59051840791988e-6, 1.12356197979857e-6, 7.3527551487574e-7, 4.6450130357806e-7,
     3.3096079921048e-7, 2.2512612292678e-7, 1.4879129266490e-7, 1.6828623364192e-7]
)  # fmt: skip

#: Rayleigh's formula for the CO2 of Mars: the air's, times the molecules above a square meter
#: (610 Pa / 101,325 Pa * 9.81 / 3.71 * 28.97 / 43.34) and their larger cross section
#: ((4.49e-4 / 2.93e-4)^2 * 1.15 / 1.05 for refraction and depolarization), over its scale height.
_CO2_OVER_AIR = 610.0 / 101_325.0 * (9.81 / 3.71) * (28.97 / 43.34) * 2.57 * (8_000.0 / 11_100.0)
#: Vertical optical depth of the dust at density 1, the same at all wavelengths: a usual one between
#: storms (Lemmon et al. 2015, Icarus 251:96).
_DUST_DEPTH = 0.5
#: Single-scattering albedo of the dust (Wolff et al. 2009, J. Geophys. Res. 114:E00D04).
_DUST_NM = np.array([388.0, 440.0, 550.0, 650.0, 700.0, 800.0])
_DUST_ALBEDO = np.array([0.73, 0.78, 0.913, 0.967, 0.975, 0.978])
#: Mean cosine of the scattering angle, likewise.
_DUST_MEAN_COSINE = np.array([0.80, 0.77, 0.70, 0.69, 0.68, 0.68])
#: Lobes fitted to skies seen by Curiosity, at 650 nm (Chen-Chen et al. 2019, Icarus 330:16).
_DUST_FORWARD, _DUST_WIDE, _DUST_LOBES_NM = 0.889, 0.094, 650.0


def earth(count: int, air: float, dust: float, ozone: float) -> AirMedium:
    """Earth's atmosphere at so many wavelengths."""
    nm = wavelengths(count)
    ones = np.ones(count)
    return AirMedium(
        planet=EARTH,
        gas=air * _AIR / (nm * nm * nm * nm),
        aerosol=dust * _AEROSOL * ones,
        aerosol_loss=dust * _AEROSOL_LOSS * ones,
        layer=ozone * np.interp(nm, np.arange(380.0, 781.0, 20.0), _OZONE),
        phase=np.stack([ones, _AEROSOL_G * ones, 0.0 * ones, ones]),
    )


def mars(count: int, air: float, dust: float, ozone: float) -> AirMedium:
    """The atmosphere of Mars; its ozone, a hundredth of Earth's, is left out whatever its factor.

    Dust of 1.5 um diffracts light into a cone whose width grows with the wavelength. Measured at
    650 nm, 1 - g of the forward lobe is taken to be proportional to it, and the lobe's share
    follows from the measured mean cosine: so the light about the sun is blue (Ehlers et al. 2014,
    Appl. Opt. 53:1808), while the albedo makes the rest of the sky yellowish brown.
    """
    nm = wavelengths(count)
    ones = np.ones(count)
    loss = dust * _DUST_DEPTH / MARS.aerosol_m
    forward = 1.0 - (1.0 - _DUST_FORWARD) * nm / _DUST_LOBES_NM
    mean = np.interp(nm, _DUST_NM, _DUST_MEAN_COSINE)
    return AirMedium(
        planet=MARS,
        gas=air * _CO2_OVER_AIR * _AIR / (nm * nm * nm * nm),
        aerosol=loss * np.interp(nm, _DUST_NM, _DUST_ALBEDO),
        aerosol_loss=loss * ones,
        layer=0.0 * ones,
        phase=np.stack(
            [(mean - _DUST_WIDE) / (forward - _DUST_WIDE), forward, _DUST_WIDE * ones, 0.0 * ones]
        ),
    )


#: By name.
MEDIA = {"earth": earth, "mars": mars}
