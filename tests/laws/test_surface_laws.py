"""What holds for every closed-form prescription, whatever its numbers."""

import dataclasses
import pickle  # noqa: TID251 - what a process pool does to its arguments

import numpy as np
import pytest
from hypothesis import given, strategies as st

from laws import examples
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

REACH = 5.0  # mm; every surface drawn below is defined there, and steep enough to matter


def lengths(low=12.0, high=80.0):
    return st.floats(low, high).flatmap(lambda size: st.sampled_from([size, -size]))


small = st.floats(0.01, 1.0).flatmap(lambda size: st.sampled_from([size, -size])) | st.just(0.0)
conics = st.floats(-2.5, 1.5)


def coefficients(keys, scale):
    """Draw a few terms; ``scale(key)`` makes a coefficient of 1 reach some tenths of a millimetre."""
    return st.dictionaries(st.sampled_from(keys), small, min_size=1, max_size=4).map(
        lambda terms: {key: value * scale(key) for key, value in terms.items()}
    )


POWERS = [(i, j) for i in range(7) for j in range(7 - i)]
Q2D = [(n, m) for n in range(4) for m in range(-4, 5)]
FAMILIES = {
    "Plane": st.builds(lambda a, b: Plane(slope=(a, b)), small, small),
    "Sphere": st.builds(Sphere, radius=lengths()),
    "Conic": st.builds(Conic, radius=lengths(), conic=conics),
    "EvenAsphere": st.builds(
        EvenAsphere, radius=lengths(), conic=conics, terms=coefficients([2, 4, 6, 8], lambda n: 0.1 / REACH**n)
    ),
    "Toroid": st.builds(Toroid, radius_x=lengths(), radius_y=lengths()),
    "Biconic": st.builds(Biconic, radius_x=lengths(), radius_y=lengths(), conic_x=conics, conic_y=conics),
    "XYPolynomial": st.builds(XYPolynomial, terms=coefficients(POWERS, lambda key: 0.1 / REACH ** sum(key))),
    "RadialPolynomial": st.builds(
        lambda a, b, c, tilt: RadialPolynomial(radial=(a * 1e-2, b * 1e-4), slope=(c * 1e-2, a * 1e-4), tilt=tilt),
        *(small,) * 4,
    ),
    "Zernike": st.builds(
        Zernike, terms=coefficients(range(1, 37), lambda _: 0.05), radius=st.just(6.0), indexing=st.just("fringe")
    ),
    **{
        kind: st.builds(
            Forbes,
            radius=lengths(),
            conic=st.floats(-2.5, 0.9),
            norm_radius=st.just(6.0),
            kind=st.just(kind),
            terms=coefficients(Q2D if kind == "q2d" else range(5), lambda _: 0.05),
        )
        for kind in ("qbfs", "qcon", "q2d")
    },
}
every_family = pytest.mark.parametrize("family", FAMILIES)
places = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda p: (REACH * p[0] / 1.5, REACH * p[1] / 1.5))


@every_family
@examples(60)
@given(data=st.data(), place=places)
def test_derivatives_are_those_of_the_height(family, data, place):
    """Five-point differences of the height and of the slopes; their own error is 1e-9 or so here."""
    surface = data.draw(FAMILIES[family])
    x, y = place
    h = 2e-3
    step, weight = h * np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / (12 * h)
    zx, zy = surface.gradient(x, y)
    assert zx == pytest.approx(weight @ surface.sag(x + step, y), abs=1e-10)
    assert zy == pytest.approx(weight @ surface.sag(x, y + step), abs=1e-10)
    along_x, along_y = surface.gradient(x + step, y), surface.gradient(x, y + step)
    zxx, zxy, zyy = surface.hessian(x, y)
    assert zxx == pytest.approx(weight @ along_x[0], abs=1e-9)
    assert zxy == pytest.approx(weight @ along_x[1], abs=1e-9)
    assert zxy == pytest.approx(weight @ along_y[0], abs=1e-9)
    assert zyy == pytest.approx(weight @ along_y[1], abs=1e-9)


@every_family
@examples(20)
@given(data=st.data(), count=st.integers(1, 300))
def test_a_point_does_not_depend_on_its_company(family, data, count):
    """Blocks, remainders, orders, shapes and read-only arrays change the last digit at most."""
    surface = data.draw(FAMILIES[family])
    rng = np.random.default_rng(count)
    x, y = rng.uniform(-3, 3, (2, count))
    kept = x.copy(), y.copy()
    full = surface.evaluate(x, y, 2)
    frozen = x.view()
    frozen.flags.writeable = False
    for order, rows in ((0, 1), (1, 3)):
        assert np.array(surface.evaluate(frozen, y, order)) == pytest.approx(np.array(full[:rows]), abs=1e-13)
    one = np.array([surface.evaluate(x[i : i + 1], y[i : i + 1], 2) for i in (0, count // 2, count - 1)])[:, :, 0]
    assert one == pytest.approx(np.array(full).T[[0, count // 2, count - 1]], abs=1e-13)
    table = surface.evaluate(x.reshape(1, count, 1), y.reshape(1, count, 1), 2)
    assert all(row.shape == (1, count, 1) and row.flags.c_contiguous for row in table)
    assert np.array_equal(np.array(table).reshape(6, count), np.array(full))
    assert np.array_equal(x, kept[0])
    assert np.array_equal(y, kept[1])


@every_family
@examples(5)
@given(data=st.data())
def test_a_surface_is_a_value(family, data):
    """It can be copied, sent to another process, compared and hashed, and it can be replaced."""
    surface = data.draw(FAMILIES[family])
    for other in (pickle.loads(pickle.dumps(surface)), dataclasses.replace(surface)):  # noqa: S301 - our own bytes
        assert other == surface
        assert hash(other) == hash(surface)
        assert other.sag(1.0, 2.0) == surface.sag(1.0, 2.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(surface, dataclasses.fields(surface)[0].name, 1.0)


@examples(100)
@given(st.tuples(*FAMILIES.values()), places, st.floats(0.2, 5.0))
def test_scaled_lengths_scale_the_heights(surfaces, place, scale):
    """All lengths times k: heights times k, slopes the same, second derivatives over k."""
    x, y = place
    for surface in surfaces:
        larger = scaled(surface, scale)
        assert larger.sag(scale * x, scale * y) == pytest.approx(scale * surface.sag(x, y), rel=1e-12, abs=1e-13)
        slopes = np.array(surface.gradient(x, y))
        assert np.array(larger.gradient(scale * x, scale * y)) == pytest.approx(slopes, rel=1e-11, abs=1e-12)
        second = np.array(surface.hessian(x, y)) / scale
        assert np.array(larger.hessian(scale * x, scale * y)) == pytest.approx(second, rel=1e-10, abs=1e-11)
        assert larger.feature_size == pytest.approx(scale * surface.feature_size, rel=1e-9)


def scaled(surface, k):
    """Return the same shape, k times as large: each field by its dimension."""
    changes = {}
    for field in dataclasses.fields(surface):
        value = getattr(surface, field.name)
        if field.name in {"radius", "radius_x", "radius_y", "norm_radius"}:
            changes[field.name] = value * k
        elif field.name == "terms":
            power = {
                "EvenAsphere": lambda n: 1 - n,
                "XYPolynomial": lambda key: 1 - sum(key),
            }.get(type(surface).__name__, lambda _: 1)
            changes["terms"] = {key: a * k ** power(key) for key, a in value}
        elif field.name == "radial":
            changes["radial"] = [a * k ** (1 - 2 * n) for n, a in enumerate(value, start=1)]
        elif field.name == "slope" and isinstance(surface, RadialPolynomial):
            changes["slope"] = [a * k ** (-2 * n) for n, a in enumerate(value, start=1)]
    return dataclasses.replace(surface, **changes)


@examples(60)
@given(st.integers(1, 36), places, st.floats(-4, 4))
def test_a_turned_zernike_pair_keeps_its_power(index, place, turn):
    """Cosine and sine of one order turn into each other: the sum of their squares does not depend on the angle."""
    pairs = {2: 3, 5: 6, 7: 8, 10: 11, 12: 13, 17: 18, 28: 29}
    first = max(i for i in pairs if i <= max(index, 2))
    cosine, sine = (Zernike(terms={i: 1.0}, radius=6.0, indexing="fringe") for i in (first, pairs[first]))
    (x, y), c, s = place, np.cos(turn), np.sin(turn)
    powers = [cosine.sag(u, v) ** 2 + sine.sag(u, v) ** 2 for u, v in ((x, y), (c * x - s * y, s * x + c * y))]
    assert powers[0] == pytest.approx(powers[1], rel=1e-10, abs=1e-13)
