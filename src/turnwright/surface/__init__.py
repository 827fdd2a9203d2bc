"""Surface prescriptions: one family per module, each a `Surface`."""

from turnwright.surface.base import FAMILIES, Family, Lenslets, Series, Surface
from turnwright.surface.compound import Placed, Sum
from turnwright.surface.conic import Conic, EvenAsphere, Plane, Sphere
from turnwright.surface.disc import disc_sum
from turnwright.surface.expression import Expression
from turnwright.surface.forbes import Forbes
from turnwright.surface.gridded import Gridded
from turnwright.surface.lens_array import LensArray
from turnwright.surface.off_axis import OffAxis
from turnwright.surface.polynomial import RadialPolynomial, XYPolynomial
from turnwright.surface.radial_table import RadialTable
from turnwright.surface.scattered import Scattered
from turnwright.surface.sine_grid import SineGrid
from turnwright.surface.toroid import Biconic, Toroid
from turnwright.surface.zernike import FIRST, Indexing, Zernike, zernike_order

__all__ = [
    "FAMILIES",
    "FIRST",
    "Biconic",
    "Conic",
    "EvenAsphere",
    "Expression",
    "Family",
    "Forbes",
    "Gridded",
    "Indexing",
    "LensArray",
    "Lenslets",
    "OffAxis",
    "Placed",
    "Plane",
    "RadialPolynomial",
    "RadialTable",
    "Scattered",
    "Series",
    "SineGrid",
    "Sphere",
    "Sum",
    "Surface",
    "Toroid",
    "XYPolynomial",
    "Zernike",
    "disc_sum",
    "zernike_order",
]
