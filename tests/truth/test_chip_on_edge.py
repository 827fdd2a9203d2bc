"""Whether the chip of a pass stays on the cutting edge.

Oracle: brute force. Every revolution of the edge stands over a dense line through the axis, against the stock and all
revolutions before it, half a turn earlier on the other side of the axis too; nothing of `turnwright` but the tool's
numbers is used.
"""

import math

import numpy as np
import pytest

import turnwright as tw
from cases import every_third
from turnwright.access import check_depths, largest_depth


def sphere(bend):
    """Height and slope of a sphere along the line, beyond nothing."""
    return lambda r: bend - math.copysign(1, bend) * np.sqrt(bend**2 - r**2)


def chips_beyond(bend, aperture, nose, half, depth, feed, inside_out):
    """Most that any revolution but the first cuts beyond its arc on the leading and on the trailing side. [mm]."""
    f = sphere(bend)
    line = np.linspace(-1.6 * aperture, 1.6 * aperture, 6401)
    slope = aperture / math.sqrt(bend**2 - aperture**2) * math.copysign(1, bend)
    away = np.abs(line)
    finished = np.where(
        away <= aperture, f(np.minimum(away, aperture)), f(aperture) + max(slope, 0.0) * (away - aperture)
    )
    end = nose * math.sin(half)

    def edge(u):
        flank = nose * (1 - math.cos(half)) + (np.abs(u) - end) * math.tan(half)
        return np.where(np.abs(u) <= end, nose - np.sqrt(np.maximum(nose**2 - u**2, 0)), flank)

    contact = np.linspace(-1, 1, 20_001) * (aperture + nose)
    left = finished + depth
    turns = np.arange(0, aperture / feed + 3, 0.5)
    worst = {"leading": 0.0, "trailing": 0.0}
    for turn in turns:
        tip = feed * turn if inside_out else aperture + feed * (3 - turn)
        side = 1 if turn == int(turn) else -1
        z = float((f(contact) - edge(contact - side * tip)).max())
        stands = z + edge(line - side * tip)
        cut = left - stands
        if side > 0 and turn >= 2 and 0 <= tip <= aperture * (1 + 1e-9):
            out = line - tip
            for sign, beyond in ((1, out > end), (-1, out < -end)):
                which = "leading" if (sign > 0) == inside_out else "trailing"
                at_end = np.interp(tip + sign * end, line, left) - z - float(edge(np.array(end)))
                worst[which] = max(worst[which], float(cut[beyond].max(initial=at_end)))
        left = np.minimum(left, stands)
    return worst


@pytest.mark.parametrize(("seed", "inside_out"), every_third(range(8), [False, True]))
def test_the_limit_is_where_a_chip_leaves_the_arc(seed, inside_out):
    rng = np.random.default_rng(seed)
    aperture, nose = 3.0, rng.uniform(0.2, 0.6)
    slope = rng.uniform(0.05, 0.5)
    bend = aperture / math.sin(slope) * (-1) ** seed
    half = slope + rng.uniform(0.1, 0.4)
    part = tw.Part(surface=tw.Sphere(radius=bend), radius=aperture)
    tool = tw.Tool(nose_radius=nose, included=2 * half)
    (finding,) = check_depths(part, tool, {"finish": 0.01}, inside_out=inside_out)
    for share in (0.97, 1.03):
        depth = share * finding.limit
        (judged,) = check_depths(part, tool, {"finish": depth}, inside_out=inside_out)
        worst = chips_beyond(bend, aperture, nose, half, depth, 0.02, inside_out)
        assert judged.ok is (share < 1)
        assert (worst["leading"] > 2e-5) is (share > 1)
        assert worst["trailing"] < 2e-5


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("inside_out", [False, True])
def test_the_limit_on_a_cone_of_tangents_is_closed(sign, inside_out):
    """On a tilted flat all is straight: the sweep of the chip is the slope and acos(1 - t/R), t along the normal."""
    nose, half, slope = 0.5, math.radians(50), math.radians(15)
    part = tw.Part(surface=tw.Plane(slope=(sign * math.tan(slope), 0.0)), radius=5.0)
    most, (x, _) = largest_depth(part, tw.Tool(nose_radius=nose, included=2 * half), side=1 if inside_out else -1)
    # At the azimuth where the flat rises toward the leading side there is the least room.
    assert most == pytest.approx(nose * (1 - math.cos(half - slope)) / math.cos(slope), rel=1e-9)
    assert x * sign * (1 if inside_out else -1) > 0


def test_sound_jobs_on_bowls_and_domes_are_taken():
    """A bowl cut from the rim: the leading side has the slope's room more; both sides counted would refuse it."""
    tool = tw.Tool(nose_radius=0.5, included=math.radians(100), clearance=0.2)
    bowl = tw.Part(surface=tw.Sphere(radius=10.0), radius=5.0)
    (finding,) = check_depths(bowl, tool, {"finish": 0.1})
    assert finding.ok
    assert finding.limit > 0.5 * (1 - math.cos(math.radians(50)))
    both = 0.5 * (1 - math.cos(math.radians(50 - 30))) / math.cos(math.radians(30))
    (outward,) = check_depths(bowl, tool, {"finish": 0.1}, inside_out=True)
    assert not outward.ok
    assert outward.limit < 1.2 * both


def test_flanks_that_cut_take_more():
    part = tw.Part(surface=tw.Plane(), radius=5.0)
    plain = tw.Tool(nose_radius=0.5, included=math.radians(60), clearance=0.2)
    long = tw.Tool(nose_radius=0.5, included=math.radians(60), clearance=0.2, edge_length=0.2)
    limits = [check_depths(part, tool, {"a": 0.01})[0].limit for tool in (plain, long)]
    assert limits[0] == pytest.approx(0.5 * (1 - math.cos(math.radians(30))), rel=1e-12)
    assert limits[1] - limits[0] == pytest.approx(0.2 * math.sin(math.radians(30)), rel=1e-12)
    assert check_depths(part, plain, {"none": 0.0}) == ()


def test_lenslets_bend_the_layer():
    """Concave lenslets nearly as round as the nose: a concentric layer is met farther out than one on a flat."""
    lens, nose = 0.9, 0.5
    array = tw.LensArray.square(pitch=0.6, lenslet=tw.Sphere(radius=lens), rows=9, columns=9)
    part = tw.Part(surface=array, radius=2.0)
    tool = tw.Tool(nose_radius=nose, included=math.radians(150))
    on_flat = nose * (1 - math.cos(math.radians(75)))
    (finding,) = check_depths(part, tool, {"finish": 0.01})
    assert finding.limit < 0.9 * on_flat


def test_the_search_for_the_thinnest_place_announces_its_work():
    """Features of 0.1 um under an edge of 0.5 mm take minutes: their number is reported before the first."""
    heard = []
    part = tw.Part(surface=tw.Sphere(radius=20.0), radius=1.0)
    check_depths(part, tw.Tool(nose_radius=0.5, included=1.0), {"a": 0.01}, progress=lambda *one: heard.append(one))
    (total,) = {one[1] for one in heard}
    done = [one[0] for one in heard]
    assert done == sorted(done)
    assert done[-1] == total > 1
