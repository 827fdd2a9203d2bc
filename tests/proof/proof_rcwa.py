"""Diffraction orders of round cusps by rigorous theory (RCWA), for the table of ``tests/truth/test_optics_orders.py``.

It needs ``meent`` (pip install meent), which is no dependency of the tests: python -m tests.proof.proof_rcwa
"""

import numpy as np

try:
    import meent
except ImportError:
    meent = None

from turnwright.optics import profile_orders

WAVELENGTH, NOSE_RADIUS = 0.633e-3, 0.02
LAYERS, ORDERS, CELLS = 16, 30, 4000


def cusps(feed):
    """Return one period of round cusps [mm]."""
    x = (np.arange(CELLS) + 0.5) / CELLS * feed - feed / 2
    return NOSE_RADIUS - np.sqrt(NOSE_RADIUS**2 - x * x)


def rigorous(feed, index):
    """Return the unpolarised first order of transmitted and of reflected light, each over its sum; None if in doubt."""
    z = cusps(feed)
    height = NOSE_RADIUS - np.sqrt(NOSE_RADIUS**2 - feed**2 / 4)
    levels = height * (1 - (np.arange(LAYERS) + 0.5) / LAYERS)
    shares = []
    for polarisation in (0, 1):
        solver = meent.call_mee(
            backend=0, pol=polarisation, n_top=1.0, n_bot=index, theta=0.0, phi=0.0, fto=[ORDERS, 0],
            wavelength=WAVELENGTH, period=[feed, feed], thickness=[height / LAYERS] * LAYERS,
            ucell=np.where(z > levels[:, None, None], index, 1.0), type_complex=0,
        )  # fmt: skip
        made = solver.conv_solve()
        if abs(made.de_ri.sum() + made.de_ti.sum() - 1) > 1e-3:
            return None
        shares.append([light[0, ORDERS + 1] / light.sum() for light in (made.de_ti, made.de_ri)])
    return np.mean(shares, axis=0)


if __name__ == "__main__":
    if meent is None:
        print("meent is not installed: nothing is compared")
    for index in (1.5, 2.4, 4.0) if meent else ():
        for wavelengths in (2.5, 4, 6, 10):
            feed = wavelengths * WAVELENGTH
            scalar = [
                float(profile_orders(cusps(feed), wavelength=WAVELENGTH, orders=1, index=n)) for n in (index, None)
            ]
            print(index, wavelengths, rigorous(feed, index), scalar)
