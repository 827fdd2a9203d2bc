"""Compute the three maps of Fig. 15 of Li et al. 2018, on a flat and on the sinusoidal grid.

Run from the root of the repository, some minutes: ``python docs/papers/li2018_fig15/make.py``. The third parameter of
each map is that of the paper's own cut: a nose of 0.514 mm, 0.5 mm/min, 50 rev/min. A patch stands askew to the feed,
or its pixels meet the cusps in few phases; on the grid one lies in a trough and one on a crest.
"""

from pathlib import Path

from turnwright import Job
from turnwright.studies import study

HERE = Path(__file__).parent
NOSE, FEED, SPEED = "0.1..1 mm:10", "0.2..1 mm/min:9", "50..150 rpm:11"
MAPS = {
    "nose-feed": {"tool.nose_radius": NOSE, "strategy.feed": FEED},
    "nose-speed": {"tool.nose_radius": NOSE, "strategy.spindle_speed": SPEED, "strategy.feed": "0.5 mm/min"},
    "feed-speed": {"strategy.feed": FEED, "strategy.spindle_speed": SPEED},
}


def patch(name, x, y):
    return {"name": name, "centre": [f"{x} mm", f"{y} mm"], "size": ["0.3 mm", "0.3 mm"], "pixel": "0.7 um"}


def job(surface):
    data = Job.load(HERE.parents[2] / "examples" / "li2018_sine_grid.toml").table()
    # 1200 points a turn leave chords of 0.03 nm on the grid, which is a quarter of the lowest Sq here.
    data["strategy"]["points_per_rev"] = 3600
    data["roughness"] = {"form": "mean"}
    if surface == "flat":
        data["part"]["surface"] = {"family": "plane"}
        patches = [patch("askew", 1.1, 0.4)]
    else:
        patches = [patch("trough", -0.625, -0.625), patch("crest", 0.625, 0.625), patch("askew", 1.1, 0.4)]
    data["simulation"]["patches"] = patches
    return Job.read(data)


def measures(surface):
    return ["sq_nm@askew"] if surface == "flat" else ["sq_nm@trough", "sq_nm@crest", "sq_nm@askew"]


if __name__ == "__main__":
    for surface in ("flat", "grid"):
        for name, vary in MAPS.items():
            results = study(job(surface), vary=vary, measure=measures(surface))
            results.save(HERE / f"{surface}-{name}")
            print(f"{surface}-{name}: {len(results)} cases, {sum(results.seconds):.0f} s")
