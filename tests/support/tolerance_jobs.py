"""Small jobs for studies of tolerances."""

import turnwright as tw

MIRROR = {
    "part": {"name": "mirror", "radius": "3 mm", "surface": {"family": "sphere", "radius": "40 mm"}},
    "tool": {"nose_radius": "0.5 mm", "included": "60 deg", "clearance": "10 deg"},
    "machine": {"name": "nanotech-350fg"},
    "strategy": {
        "kind": "slow tool servo", "feed": "10 um/rev", "spindle_speed": "200 rpm", "points_per_rev": 180,
    },
    "simulation": {
        "patches": [
            {"name": "half-way out", "centre": ["1.5 mm", "0 mm"], "size": ["60 um", "60 um"], "pixel": "1 um"},
            {"name": "axis", "centre": ["0 mm", "0 mm"], "size": ["60 um", "60 um"], "pixel": "1.5 um"},
        ]
    },
    "tolerances": {"form_pv": "100 nm", "sq": "12 nm"},
}  # fmt: skip

SERVO = """
name = "with servos"
spindle_rpm = 500
block_rate_hz = 2000
dialect = "generic"
[axes.X]
speed = "25 mm/s"
acceleration = "300 mm/s^2"
response = { frequency = "60 Hz", damping = 0.7, velocity_feedforward = 1.0 }
[axes.Z]
speed = "25 mm/s"
acceleration = "300 mm/s^2"
response = { frequency = "60 Hz", damping = 0.7 }
[axes.C]
"""


def job_of(kind, folder=None):
    """Return a small job."""
    table = {key: dict(value) for key, value in MIRROR.items()}
    if kind == "flat":
        table["part"] = {"radius": "3 mm", "surface": {"family": "plane", "slope": [0.0, 0.0]}}
        table["strategy"] |= {"feed": "5 um/rev", "points_per_rev": 48}
    elif kind == "lens array":
        lenslet = {"family": "sphere", "radius": "20 mm"}
        table["part"]["surface"] = {
            "family": "lens array", "layout": "square", "lenslet": lenslet, "pitch": "1.5 mm", "within": "4 mm",
        }  # fmt: skip
        table["strategy"] |= {"points_per_rev": 1440, "feed": "20 um/rev"}
    elif kind == "raked over the axis":
        table["part"]["surface"] = {
            "family": "sine grid",
            "amplitude": ["2 um", "2 um"],
            "period": ["2.5 mm", "2.5 mm"],
        }
        table["tool"]["rake"] = "-20 deg"
        table["strategy"]["overrun"] = "5 um"
    elif kind == "fine mirror":
        table["strategy"] |= {"feed": "2 um/rev", "points_per_rev": 90}
        table["simulation"] = {
            "patches": [
                {"name": "half-way out", "centre": ["1.5 mm", "0 mm"], "size": ["30 um", "6 um"], "pixel": "0.13 um"}
            ]
        }
    elif kind == "servo":
        table["strategy"]["feed"] = "20 um/rev"
        (folder / "lathe.toml").write_text(SERVO)
        table["machine"] = {"file": str(folder / "lathe.toml")}
        table["part"] = {"radius": "1.5 mm", "surface": {
            "family": "sine grid", "amplitude": ["2 um", "2 um"], "period": ["2.5 mm", "2.5 mm"]}}  # fmt: skip
        table["simulation"] = {"tracking": True}
    return tw.Job.read(table)
