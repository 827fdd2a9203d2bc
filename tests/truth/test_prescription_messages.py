"""A wrong closed-form prescription cannot exist, and says in one sentence what is wrong, how much, and what to do."""

import numpy as np
import pytest

from turnwright.errors import DomainError, InputError
from turnwright.surface import (
    Biconic,
    Conic,
    EvenAsphere,
    Forbes,
    Plane,
    RadialPolynomial,
    Sphere,
    Toroid,
    XYPolynomial,
    Zernike,
)

NAN, INF = float("nan"), float("inf")


def forbes(**more):
    return Forbes(**{"radius": 50.0, "conic": 0.0, "norm_radius": 10.0, "kind": "qbfs", "terms": {}} | more)


def asphere(terms):
    return EvenAsphere(radius=9.0, conic=0.0, terms=terms)


def zernike(terms, indexing="fringe", **more):
    return Zernike(**{"terms": terms, "radius": 10.0, "indexing": indexing} | more)


WRONG = {
    "plane with one slope": (lambda: Plane(slope=(1.0,)), "2 finite numbers"),
    "plane with nan": (lambda: Plane(slope=(0.0, NAN)), "finite"),
    "sphere of no radius": (lambda: Sphere(radius=0.0), "is 0 mm, it must not be 0"),
    "sphere of nan": (lambda: Sphere(radius=NAN), "radius is nan"),
    "sphere of words": (lambda: Sphere(radius="10 mm"), "radius is '10 mm'"),
    "conic of no radius": (lambda: Conic(radius=0, conic=-1.0), "radius of a conic"),
    "conic constant inf": (lambda: Conic(radius=10.0, conic=INF), "conic is inf"),
    "odd asphere": (lambda: asphere({3: 1e-3}), "is 3, it must be even"),
    "asphere from 0": (lambda: asphere({0: 1e-3}), "is 0, it must be even"),
    "asphere to 102": (lambda: asphere({102: 1e-3}), "from 2 to 100"),
    "asphere by name": (lambda: asphere({"4": 1e-3}), "is '4'"),
    "asphere with nan": (lambda: asphere({4: NAN}), "terms[4] is nan"),
    "asphere twice": (lambda: asphere([(4, 1.0), (4, 2.0)]), "term 4 twice"),
    "toroid of no radius": (lambda: Toroid(radius_x=5.0, radius_y=0.0), "radius_y of a toroid"),
    "biconic of nan": (lambda: Biconic(radius_x=NAN, radius_y=1.0, conic_x=0.0, conic_y=0.0), "radius_x is nan"),
    "biconic conic": (lambda: Biconic(radius_x=9.0, radius_y=9.0, conic_x=0.0, conic_y=NAN), "conic_y is nan"),
    "negative power": (lambda: XYPolynomial(terms={(1, -1): 1.0}), "neither may be below 0"),
    "power of 1.5": (lambda: XYPolynomial(terms={(1.5, 0): 1.0}), "whole number"),
    "one power": (lambda: XYPolynomial(terms={2: 1.0}), "pair of whole numbers"),
    "huge power": (lambda: XYPolynomial(terms={(9000, 9000): 1.0}), "sum above 100"),
    "nan in a polynomial": (lambda: XYPolynomial(terms={(1, 1): NAN}), "terms[(1, 1)] is nan"),
    "radial as a number": (lambda: RadialPolynomial(radial=1e-3), "list of at most 49"),
    "radial with nan": (lambda: RadialPolynomial(radial=(1e-3, NAN)), "radial holds nan"),
    "tilt of nan": (lambda: RadialPolynomial(tilt=NAN), "tilt is nan"),
    "fringe 0": (lambda: zernike({0: 1e-3}), "fringe index of a Zernike term is 0, it must be"),
    "noll 0": (lambda: zernike({0: 1e-3}, "noll"), "noll index of a Zernike term is 0, it must be"),
    "ansi -1": (lambda: zernike({-1: 1e-3}, "ansi"), "index of a Zernike term is -1"),
    "index True": (lambda: zernike({True: 1e-3}), "is True"),
    "huge index": (lambda: zernike({10**12: 1e-3}), "means degree"),
    "37 and 49": (lambda: zernike({37: 1e-3, 49: 1e-3}), "terms 37 and 49 are both the polynomial (12, 0)"),
    "osa": (lambda: zernike({1: 1e-3}, "osa"), "known are fringe, noll and ansi"),
    "no aperture": (lambda: zernike({1: 1e-3}, radius=0.0), "radius of a Zernike surface is 0 mm"),
    "nan in zernike": (lambda: zernike({1: NAN}), "terms[1] is nan"),
    "forbes kind": (lambda: forbes(kind="qbf"), "known are qbfs, qcon and q2d"),
    "forbes norm": (lambda: forbes(norm_radius=-1.0), "norm_radius of a Forbes surface is -1 mm"),
    "forbes beyond": (lambda: forbes(norm_radius=60.0), "its conic ends at 50 mm"),
    "forbes negative": (lambda: forbes(terms={-1: 1e-3}), "index of a Forbes term is -1"),
    "forbes pair": (lambda: forbes(terms={(1, 1): 1e-3}), "index of a Forbes term is (1, 1)"),
    "q2d single": (lambda: forbes(kind="q2d", terms={1: 1e-3}), "pair of whole numbers"),
    "q2d negative n": (lambda: forbes(kind="q2d", terms={(-1, 2): 1e-3}), "is -1"),
    "forbes huge": (lambda: forbes(terms={49: 1e-3}), "has degree 102"),
    "forbes radius": (lambda: forbes(radius=0.0), "radius of a Forbes surface"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_prescription(case):
    build, words = WRONG[case]
    with pytest.raises(InputError) as caught:
        build()
    message = str(caught.value)
    assert words in message
    assert ": " in message, "the remedy follows a colon"
    assert "\n" not in message


@pytest.mark.parametrize(
    "surface",
    [
        Sphere(radius=-4.0),
        Conic(radius=4.0, conic=0.5),
        EvenAsphere(radius=4.0, conic=0.0, terms={4: 1e-4}),
        Toroid(radius_x=4.0, radius_y=20.0),
        Biconic(radius_x=4.0, radius_y=20.0, conic_x=0.0, conic_y=0.0),
        Forbes(radius=4.0, conic=0.0, norm_radius=3.0, kind="qbfs", terms={0: 1e-3}),
    ],
    ids=lambda surface: type(surface).__name__,
)
def test_outside_the_domain(surface):
    with pytest.raises(
        DomainError, match=rf"{type(surface).__name__} is not defined at x = 4\.5 mm.*\(1 of 2 points\)"
    ):
        surface.sag([1.0, 4.5], 0.0)
    with pytest.raises(DomainError, match="clear aperture is 5 mm"):
        surface.require_disc(5.0, "the radius of the clear aperture")
    surface.require_disc(3.0, "the radius of the clear aperture")
    rows = surface.evaluate(np.array([4.5, 1.0]), np.zeros(2), 2)
    assert all(np.isfinite(row[1]) for row in rows)
