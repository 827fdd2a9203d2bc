"""Sine and cosine that vectorise: exact reduction of large spindle angles, then fdlibm's polynomials.

Good to 1 unit in the last place up to a quarter of a million turns (checked against mpmath in the tests).
"""

import numpy as np

from turnwright._kernels import jit

# pi/2 in three parts of 33 bits (fdlibm, e_rem_pio2): n times each of the first two is exact for n < 2**20.
PIO2_1 = 1.57079632673412561417e00
PIO2_2 = 6.07710050630396597660e-11
PIO2_3 = 2.02226624879595063154e-21
TWO_OVER_PI = 0.636619772367581343076


@jit
def sincos(angle):
    """Return (sin, cos) of one angle [rad]."""
    n = np.floor(angle * TWO_OVER_PI + 0.5)
    r = angle - n * PIO2_1
    r = r - n * PIO2_2
    r = r - n * PIO2_3
    z = r * r
    s = r + r * z * (
        -1.66666666666666324348e-01
        + z
        * (
            8.33333333332248946124e-03
            + z
            * (
                -1.98412698298579493134e-04
                + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
            )
        )
    )
    c = (
        1.0
        - 0.5 * z
        + z
        * z
        * (
            4.16666666666666019037e-02
            + z
            * (
                -1.38888888888741095749e-03
                + z
                * (
                    2.48015872894767294178e-05
                    + z
                    * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
                )
            )
        )
    )
    quadrant = n - 4.0 * np.floor(0.25 * n)
    odd = quadrant == 1.0 or quadrant == 3.0
    first = c if odd else s
    second = s if odd else c
    sine = -first if quadrant >= 2.0 else first
    cosine = -second if (quadrant == 1.0 or quadrant == 2.0) else second
    return sine, cosine


@jit
def small_arctan(t):
    """Return the arc tangent of a number from -7/16 to 7/16, by fdlibm's polynomial (s_atan)."""
    z = t * t
    w = z * z
    odd = z * (
        3.33333333333329318027e-01
        + w
        * (
            1.42857142725034663711e-01
            + w
            * (
                9.09088713343650656196e-02
                + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02))
            )
        )
    )
    even = w * (
        -1.99999999998764832476e-01
        + w
        * (
            -1.11111104054623557880e-01
            + w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))
        )
    )
    return t - t * (odd + even)
