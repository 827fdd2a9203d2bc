"""Commands for materials: list, show, and fit to measured forces."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright._io import write_atomic
from turnwright.cli.shared import Session, app, require_picture, require_unused, show_progress
from turnwright.progress import Step
from turnwright.units import say_length

if TYPE_CHECKING:
    from turnwright.material import CriticalThickness, CuttingCoefficient, Material

__all__: list[str] = []

REFERENCE_THICKNESS = 1e-3
"""Uncut chip thickness at which varying coefficients are listed. [mm]"""

materials = typer.Typer(help="List, show and fit materials.")
app.add_typer(materials, name="material")

Name = Annotated[str, typer.Argument(metavar="NAME", help="A listed name, or a .toml file.", show_default=False)]
Data = Annotated[
    Path,
    typer.Argument(metavar="DATA", help="Experiment as .toml, or averaged cuts as .csv.", show_default=False),
]
Picture = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Picture of fit and residuals to write: .png, .svg or .pdf.", show_default=False),
]
Out = Annotated[Path, typer.Option(metavar="FILE", help="Material file to write, .toml.", show_default=False)]


@materials.command("list")
def list_all(context: typer.Context) -> None:
    """List the materials supplied with Turnwright."""
    session: Session = context.obj
    from turnwright.material import Material  # noqa: PLC0415

    for name in Material.known():
        material = Material.load(name)
        critical = material.critical
        limit = "no brittle limit" if critical is None else f"ductile to {critical.value * 1e6:.4g} nm"
        varies = "" if critical is None else _describe_dependence(critical).replace("; varies", " and varies")
        session.echo(f"{name}: {material.name}; {_describe_forces(material)}; {limit}{varies}")


@materials.command()
def show(context: typer.Context, name: Name) -> None:
    """Show the data and sources of a material."""
    session: Session = context.obj
    from turnwright.material import Material  # noqa: PLC0415

    material = Material.load(name)
    session.echo(material.name)
    for label, coefficient in (("cutting coefficient", material.cutting), ("thrust coefficient", material.thrust)):
        session.echo(f"{label}: {'not known' if coefficient is None else _describe_coefficient(coefficient)}")
    critical = material.critical
    session.echo(f"critical chip thickness: {'none stated' if critical is None else _describe_critical(critical)}")
    if material.notes:
        session.echo(f"note: {material.notes}")
    for key, source in material.sources.items():
        session.echo(f"source of {key}: {source}")


@materials.command()
def fit(context: typer.Context, data: Data, out: Out, picture: Picture = None) -> None:
    """Fit a material model to measured forces."""
    session: Session = context.obj
    require_unused(out)
    if picture is not None:
        require_picture(picture)
    import tomli_w  # noqa: PLC0415

    from turnwright.cutting import learn_from_file  # noqa: PLC0415

    with show_progress(session.stop, [Step(stage="learn", work=5.0)]) as progress:
        progress("learn", 0, 1)
        experiment = learn_from_file(data)
        text = tomli_w.dumps(experiment.table())
        progress("learn", 1, 1)
    if picture is not None:
        from turnwright.report import write_fit_picture  # noqa: PLC0415 - imports matplotlib

        write_fit_picture(experiment, picture)
    write_atomic(out, text)
    for sentence in experiment.learned.sentences:
        session.echo(sentence)
    session.echo(f"material: {out}")
    if picture is not None:
        session.echo(f"picture: {picture}")


def _describe_forces(material: Material) -> str:
    """Summarise the coefficients; if they vary with the chip thickness, at the reference thickness."""
    cutting, thrust = material.cutting, material.thrust
    if cutting is None or thrust is None:
        return "no coefficients"
    if cutting.constant and thrust.constant:
        return f"Kc {cutting.value:.5g}, Kt {thrust.value:.5g} N/mm^2"
    at = [float(value) for value in material.coefficients(REFERENCE_THICKNESS)]
    if not material.caution(REFERENCE_THICKNESS):
        return f"Kc {at[0]:.5g}, Kt {at[1]:.5g} N/mm^2 at 1 um"
    estimates = []
    for label, value, coefficient in zip(("Kc", "Kt"), at, (cutting, thrust), strict=True):
        relative = coefficient.uncertainty
        spread = "" if relative is None else f" +- {100 * relative / coefficient.value:.0f} %"
        estimates.append(f"{label} about {float(f'{value:.2g}'):.0f}{spread}")
    return f"an estimate, {', '.join(estimates)} N/mm^2 at 1 um"


def _describe_dependence(quantity: CuttingCoefficient | CriticalThickness) -> str:
    """Return what a property depends on, as a clause."""
    names = [
        name
        for name, is_dependent in (
            ("chip thickness", not getattr(quantity, "constant", True)),
            ("rake", quantity.rake is not None),
            ("crystal direction", quantity.lobes is not None),
        )
        if is_dependent
    ]
    return f"; varies with {', '.join(names)}" if names else ""


def _describe_coefficient(coefficient: CuttingCoefficient) -> str:
    reference, bounds = coefficient.reference_thickness, coefficient.stated
    spread = "" if coefficient.uncertainty is None else f" +- {coefficient.uncertainty:.3g}"
    at = "" if reference is None else f" at {say_length(reference, 4)}"
    power = f", decreasing with chip thickness to the power {coefficient.exponent:g}" if coefficient.exponent else ""
    valid = ""
    if bounds is not None:
        valid = f"; valid for chips of {say_length(bounds[0], 4)} to {say_length(bounds[1], 4)}"
    return f"{coefficient.value:.5g}{spread} N/mm^2{at}{power}{_describe_dependence(coefficient)}{valid}"


def _describe_critical(critical: CriticalThickness) -> str:
    spread = "" if critical.uncertainty is None else f" +- {critical.uncertainty * 1e6:.3g}"
    return f"{critical.value * 1e6:.4g}{spread} nm{_describe_dependence(critical)}"
