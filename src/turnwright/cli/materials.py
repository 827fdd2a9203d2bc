"""The commands of what is cut: which materials are known, what is known of one, and what forces tell of a new one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright._io import whole_file, write_whole
from turnwright.cli.shared import Door, app, progress_of, require_new
from turnwright.errors import InputError
from turnwright.progress import Step

if TYPE_CHECKING:
    from turnwright.cutting import Experiment
    from turnwright.material import CriticalThickness, CuttingCoefficient, Material

__all__: list[str] = []

PICTURES = (".png", ".svg", ".pdf")

THIN = 1e-3
"""Chip at which coefficients that vary with it are compared. [mm]"""

materials = typer.Typer(help="The materials that are cut.")
app.add_typer(materials, name="material")

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="One of those listed, or a .toml file of your own.", show_default=False)
]
Data = Annotated[
    Path,
    typer.Argument(
        metavar="DATA", help="A .toml file of the experiment, or a .csv of averaged cuts.", show_default=False
    ),
]
Picture = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="A picture of fit and residuals, .png, .svg or .pdf.", show_default=False),
]
Out = Annotated[Path, typer.Option(metavar="FILE", help="The material's file, .toml.", show_default=False)]


@materials.command("list")
def list_all(context: typer.Context) -> None:
    """Name the materials that come with Turnwright."""
    door: Door = context.obj
    from turnwright.material import Material  # noqa: PLC0415

    for name in Material.known():
        one = Material.load(name)
        bears = "no brittle limit" if one.critical is None else f"ductile to {one.critical.value * 1e6:.4g} nm"
        varies = "" if one.critical is None else _more(one.critical).replace("; varies", " and varies")
        door.say(f"{name}: {one.name}; {_forces(one)}; {bears}{varies}")


@materials.command()
def show(context: typer.Context, name: Name) -> None:
    """Say what is known of a material, and from where."""
    door: Door = context.obj
    from turnwright.material import Material  # noqa: PLC0415

    one = Material.load(name)
    door.say(one.name)
    for what, coefficient in (("cutting coefficient", one.cutting), ("thrust coefficient", one.thrust)):
        door.say(f"{what}: {'not known' if coefficient is None else _coefficient(coefficient)}")
    door.say(f"critical thickness: {'none stated' if one.critical is None else _critical(one.critical)}")
    if one.notes:
        door.say(f"note: {one.notes}")
    for key, source in one.sources.items():
        door.say(f"source of {key}: {source}")


@materials.command()
def fit(context: typer.Context, data: Data, out: Out, picture: Picture = None) -> None:
    """Learn a material from measured forces, and write it as a file."""
    door: Door = context.obj
    require_new(out)
    if picture is not None:
        require_new(picture)
        if picture.suffix.lower() not in PICTURES:
            raise InputError(
                f"the picture {picture} ends in {picture.suffix!r}, it can be {', '.join(PICTURES)}: name it so"
            )
    import tomli_w  # noqa: PLC0415

    from turnwright.cutting import learn_from_file  # noqa: PLC0415

    with progress_of(door.stop, [Step(stage="learn", work=5.0)]) as progress:
        progress("learn", 0, 1)
        found = learn_from_file(data)
        text = tomli_w.dumps(found.table())
        progress("learn", 1, 1)
    if picture is not None:
        _draw(found, picture)
    write_whole(out, text)
    for sentence in found.learned.sentences:
        door.say(sentence)
    door.say(f"material: {out}")
    if picture is not None:
        door.say(f"picture: {picture}")


def _draw(found: Experiment, picture: Path) -> None:
    """Draw the forces beside what was learned makes of them, and what is left."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    fit, critical = found.learned.fit, found.learned.critical
    count = len(fit.components)
    figure = Figure(figsize=(4.2 * count, 5.6), layout="constrained")
    axes = figure.subplots(2, count, squeeze=False, sharex=True, height_ratios=(2, 1))
    nm = fit.thickness * 1e6
    for name, column, measured, fitted in zip(fit.components, axes.T, fit.measured.T, fit.fitted.T, strict=True):
        column[0].plot(nm, measured * 1e3, ".", ms=3, color="tab:blue", label="measured, without drift")
        column[0].plot(nm, fitted * 1e3, ".", ms=2, color="k", label="fitted")
        column[1].plot(nm, (measured - fitted) * 1e3, ".", ms=3, color="tab:blue")
        column[1].axhline(0, color="k", lw=0.8)
        column[0].set(title=name, ylabel="force [mN]")
        column[1].set(xlabel="thickest chip [nm]", ylabel="measured - fitted [mN]")
        for ax in column:
            if critical is not None:
                ax.axvspan(
                    critical.low * 1e6, critical.high * 1e6, color="tab:red", alpha=0.3, label="critical thickness"
                )
        column[0].legend(fontsize=7)
    figure.suptitle(found.name)
    with whole_file(picture) as stream:
        figure.savefig(stream, dpi=150, format=picture.suffix[1:])


def _forces(material: Material) -> str:
    """Return the coefficients at a glance: as they are, or those of a thin chip where they vary with it."""
    cutting, thrust = material.cutting, material.thrust
    if cutting is None or thrust is None:
        return "no coefficients"
    if cutting.constant and thrust.constant:
        return f"Kc {cutting.value:.5g}, Kt {thrust.value:.5g} N/mm^2"
    at = [float(one) for one in material.coefficients(THIN)]
    if not material.caution(THIN):
        return f"Kc {at[0]:.5g}, Kt {at[1]:.5g} N/mm^2 at 1 um"
    words = []
    for label, value, one in zip(("Kc", "Kt"), at, (cutting, thrust), strict=True):
        sure = "" if one.uncertainty is None else f" +- {100 * one.uncertainty / one.value:.0f} %"
        words.append(f"{label} about {float(f'{value:.2g}'):.0f}{sure}")
    return f"an estimate, {', '.join(words)} N/mm^2 at 1 um"


def _more(one: CuttingCoefficient | CriticalThickness) -> str:
    """Return what a property depends on, in words."""
    kinds = [
        word
        for word, given in (
            ("chip thickness", not getattr(one, "constant", True)),
            ("rake", one.rake is not None),
            ("direction of the crystal", one.lobes is not None),
        )
        if given
    ]
    return f"; varies with {', '.join(kinds)}" if kinds else ""


def _length(length: float) -> str:
    """Return a thickness of chip in the unit that suits it."""
    return f"{length:g} mm" if length >= 1 else f"{length * 1e3:.4g} um" if length >= 1e-3 else f"{length * 1e6:.4g} nm"


def _coefficient(one: CuttingCoefficient) -> str:
    sure = "" if one.uncertainty is None else f" +- {one.uncertainty:.3g}"
    at = "" if one.reference_thickness is None else f" at {_length(one.reference_thickness)}"
    power = f", falling with the power {one.exponent:g} of the chip" if one.exponent else ""
    stated = "" if one.stated is None else f"; stated for chips of {_length(one.stated[0])} to {_length(one.stated[1])}"
    return f"{one.value:.5g}{sure} N/mm^2{at}{power}{_more(one)}{stated}"


def _critical(one: CriticalThickness) -> str:
    sure = "" if one.uncertainty is None else f" +- {one.uncertainty * 1e6:.3g}"
    return f"{one.value * 1e6:.4g}{sure} nm{_more(one)}"
