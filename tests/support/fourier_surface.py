"""Finite Fourier series whose surface parameters are exact: products of series, closed integrals, Newton's method."""

import numpy as np
from scipy import optimize

TURN = 2 * np.pi


class Fourier:
    """z = sum of a cos 2π(p x + q y + phase) over the unit square, a in mm, p and q whole."""

    def __init__(self, terms):
        self.terms = terms
        series = {}
        for (p, q), size, phase in terms:
            for sign in (1, -1):
                key = (sign * p, sign * q)
                series[key] = series.get(key, 0) + size / 2 * np.exp(1j * sign * TURN * phase)
        self.series = series

    def __call__(self, x, y, along_x=0, along_y=0):
        """Return a derivative of the height, of order ``along_x`` by x and ``along_y`` by y."""
        order = along_x + along_y
        return sum(
            size
            * TURN**order
            * float(p) ** along_x
            * float(q) ** along_y
            * np.cos(TURN * (p * x + q * y + phase) + order * np.pi / 2)
            for (p, q), size, phase in self.terms
        )

    def moment(self, order):
        """The mean of a power of the height: the constant term of the power of the series."""
        power = {(0, 0): 1.0}
        for _ in range(order):
            product = {}
            for (a, b), one in power.items():
                for (p, q), other in self.series.items():
                    product[a + p, b + q] = product.get((a + p, b + q), 0) + one * other
            power = product
        return complex(power.get((0, 0), 0)).real

    def autocorrelation(self, x, y):
        """The mean of z z' over the part of the square that overlaps with itself shifted by (x, y)."""
        waves, sizes = np.array(list(self.series), dtype=float), np.array(list(self.series.values()))
        total = waves[:, None] + waves
        product = sizes[:, None] * sizes * np.exp(1j * TURN * (waves @ [x, y]))
        for axis, lag in enumerate((x, y)):
            width, middle = 1 - abs(lag), (1 - lag) / 2
            product = product * np.exp(1j * TURN * total[..., axis] * middle) * np.sinc(total[..., axis] * width)
        return product.sum().real

    def decay(self, direction, level=0.2):
        """The lag along a direction at which the autocorrelation has fallen to a level."""
        way, square = np.array([np.cos(direction), np.sin(direction)]), self.moment(2)

        def above(lag):
            return self.autocorrelation(*(lag * way)) / square - level

        lags = np.linspace(0, 0.5 / np.abs(way).max(), 100)
        fallen = next(k for k, lag in enumerate(lags) if above(lag) <= 0)
        return optimize.brentq(above, lags[fallen - 1], lags[fallen], xtol=1e-14)

    def decay_range(self):
        """The shortest and the longest such lag."""
        directions = np.linspace(0, np.pi, 90, endpoint=False)
        lags = [self.decay(one) for one in directions]

        def extreme(start, sign):
            near = optimize.minimize_scalar(
                lambda one: sign * self.decay(one), bounds=(start - 0.05, start + 0.05), method="bounded"
            )
            return sign * near.fun

        return extreme(directions[np.argmin(lags)], 1), extreme(directions[np.argmax(lags)], -1)

    def summit(self, x, y):
        """Return the stationary point next to a place, by Newton's method, and its height."""
        at = np.array([x, y])
        for _ in range(8):
            bend = [[self(*at, 2, 0), self(*at, 1, 1)], [self(*at, 1, 1), self(*at, 0, 2)]]
            at = at - np.linalg.solve(bend, [self(*at, 1, 0), self(*at, 0, 1)])
        return at, self(*at)
