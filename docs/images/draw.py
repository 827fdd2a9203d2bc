"""Draw the pictures of README and start page from a real run of examples/li2018_sine_grid.toml."""

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

import turnwright as tw

mpl.use("Agg")
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
NM = 1e6

job = tw.Job.load(HERE.parent.parent / "examples" / "li2018_sine_grid.toml")
with tempfile.TemporaryDirectory() as folder:
    result = tw.run(job, out=folder)
    motion = tw.read_nc(result.program.files[0], result.machine)
part, tool = result.part, result.tool
patch = next(one for one in result.predictions if one.name == "flank")
part_map = next(one for one in result.predictions if one.name == "whole part")

figure, (plan_axes, patch_axes, section_axes) = plt.subplots(
    1, 3, figsize=(12, 3.8), layout="constrained", width_ratios=(1, 1, 1.15)
)

x, y = part_map.error.points()
x, y = (np.vstack([part, part[:1]]) for part in (x, y))
shown = plan_axes.contourf(x, y, part.surface.sag(x, y) * 1e3, 24, cmap="viridis")
sparse = np.linspace(0, 12 * 2 * np.pi, 1500)
plan_axes.plot(
    5 * (1 - sparse / sparse[-1]) * np.cos(sparse), 5 * (1 - sparse / sparse[-1]) * np.sin(sparse), "w", lw=0.4
)
figure.colorbar(shown, ax=plan_axes, label="height / µm")
plan_axes.set(
    title="nominal surface and path\n(12 of 500 revolutions)", xlabel="x / mm", ylabel="y / mm", aspect="equal"
)

error = patch.error
shown = patch_axes.pcolormesh(error.x, error.y, error.z * NM, cmap="inferno", vmin=0)
figure.colorbar(shown, ax=patch_axes, label="cut minus design / nm")
patch_axes.set(title=f"predicted from the program:\nSq {patch.roughness.sq_nm:.2f} nm", xlabel="x / mm", aspect="equal")

radius = np.linspace(1.1, 1.15, 2001)
made = tw.generate_polar(motion, tool, radius=radius, angle=[0.0]).minus(part.surface)
section_axes.plot(radius, made.z[0] * NM, lw=1)
pv = tool.nose_radius - np.sqrt(tool.nose_radius**2 - job.strategy.feed**2 / 4)
section_axes.axhline(pv * NM, color="k", ls=":", lw=1)
section_axes.text(1.1, pv * NM * 1.02, f"$R - \\sqrt{{R^2 - f^2/4}}$ = {pv * NM:.2f} nm", va="bottom")
section_axes.set(title="cusps along a radius", xlabel="x / mm", ylabel="nm", ylim=(0, 30))

figure.savefig(HERE / "sine_grid.png", dpi=96, pil_kwargs={"optimize": True})
