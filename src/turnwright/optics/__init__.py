"""What a surface does to light: wavefront, point spread, MTF, diffraction and scatter, by scalar theory."""

from turnwright.optics.alvarez import alvarez_focal_length
from turnwright.optics.imaging import (
    Modulation,
    PointSpread,
    Removed,
    Wavefront,
    incidence_angles,
    path_per_height,
    wavefront,
)
from turnwright.optics.orders import (
    cusp_orders,
    order_angles,
    path_factor,
    profile_orders,
    tis,
)
from turnwright.optics.scattering import Order, Scatter, scatter

__all__ = [
    "Modulation",
    "Order",
    "PointSpread",
    "Removed",
    "Scatter",
    "Wavefront",
    "alvarez_focal_length",
    "cusp_orders",
    "incidence_angles",
    "order_angles",
    "path_factor",
    "path_per_height",
    "profile_orders",
    "scatter",
    "tis",
    "wavefront",
]
