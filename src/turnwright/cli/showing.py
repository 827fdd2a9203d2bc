"""Command that shows a measurement without its job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import Session, Unit, app, require_picture
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.profile import Profile

__all__: list[str] = []

File = Annotated[
    Path, typer.Argument(metavar="MAP", help="Measured map or profile, in any supported format.", show_default=False)
]


@app.command()
def show(
    context: typer.Context,
    file: File,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Picture to write: .png, .svg or .pdf.", show_default=False)
    ] = None,
    form: Annotated[
        str, typer.Option(help='Form to remove: "none", "mean", "plane", "sphere" or a polynomial degree.')
    ] = "plane",
    unit: Unit = None,
    lateral_unit: Annotated[str | None, typer.Option(help="Lateral unit of a text file that states none.")] = None,
    pixel_size: Annotated[
        str | None, typer.Option(help='Pixel size if the file states none, such as "0.87 um".')
    ] = None,
    profile: Annotated[bool, typer.Option("--profile", help="The file holds a profile, not a map.")] = False,
    distance: Annotated[str | None, typer.Option(help="Distance column of a profile.")] = None,
    height: Annotated[str | None, typer.Option(help="Height column of a profile.")] = None,
    number: Annotated[int | None, typer.Option(min=1, help="Number of the profile if the file holds several.")] = None,
    cutoff: Annotated[
        str | None, typer.Option(help='Roughness cut-off (L-filter) of a profile, such as "0.08 mm".')
    ] = None,
    feed: Annotated[str | None, typer.Option(help='Approximate feed of a profile, such as "10 um/rev".')] = None,
    axis: Annotated[
        str | None, typer.Option(help='Distance at which a profile crosses the spindle axis, such as "0.4 mm".')
    ] = None,
    nose_radius: Annotated[
        str | None, typer.Option(help='Tool nose radius, to predict ideal scallops, such as "0.2 mm".')
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(help="Instrument that filters the prediction: a name or .toml file.")
    ] = None,
) -> None:
    """Show a measured map or profile."""
    session: Session = context.obj
    from turnwright.metrology import level, overview  # noqa: PLC0415 - costly
    from turnwright.units import parse  # noqa: PLC0415

    if picture is not None:
        require_picture(picture)
    kind = int(form) if form.isdigit() else form

    def parse_option(quantity: str | None, unit: str = "mm") -> float | None:
        return None if quantity is None else parse(quantity, unit)

    if profile or distance is not None or height is not None or number is not None:
        from turnwright.files import read_profile  # noqa: PLC0415

        if pixel_size is not None:
            raise InputError("--pixel-size applies to maps only: use --lateral-unit for a profile")
        line = read_profile(file, distance=distance, height=height, unit=unit, lateral_unit=lateral_unit, number=number)
        drawn: HeightMap | Profile = _show_profile(
            session, line, kind, parse_option(feed, "mm/rev"), parse_option(axis), parse_option(nose_radius),
            instrument,
        )  # fmt: skip
        if cutoff is not None:
            _print_roughness(session, line, parse(cutoff, "mm"))
    else:
        from turnwright.files import read_map  # noqa: PLC0415

        if any(option is not None for option in (nose_radius, instrument, feed, axis, cutoff)):
            raise InputError("--axis, --cutoff, --feed, --nose-radius and --instrument apply to profiles only")
        heights = read_map(
            file, unit=unit, lateral_unit=lateral_unit,
            pixel_size=parse_option(pixel_size),
        )  # fmt: skip
        session.echo(heights.name)
        for name, value in overview(heights, kind):
            session.echo(f"{name}: {value}")
        drawn = level(heights, kind) if picture is not None else heights
    if picture is not None:
        from turnwright.report import write_picture  # noqa: PLC0415

        write_picture(drawn, picture)
        session.echo(f"picture: {picture}")


def _show_profile(
    session: Session,
    line: Profile,
    form: str | int,
    feed: float | None,
    axis: float | None,
    nose_radius: float | None,
    instrument: str | None,
) -> Profile:
    """Print the properties of a profile and return it with its form removed."""
    import numpy as np  # noqa: PLC0415

    from turnwright.metrology import find_cusps, without_form  # noqa: PLC0415 - costly to import
    from turnwright.units import say_length  # noqa: PLC0415

    flat = without_form(line, form)
    missing = int(np.count_nonzero(np.isnan(line.z)))
    length = float(np.ptp(line.distance))
    session.echo(line.name)
    session.echo(
        f"size: {line.z.size} points, {say_length(length / max(line.z.size - 1, 1), 4)} apart, {say_length(length, 4)}"
    )
    session.echo(f"missing: {missing} of {line.z.size} ({100 * missing / line.z.size:.3g} %)")
    session.echo(f"Pq: {flat.pq_nm:.4g} nm, Pt: {flat.pt_nm:.4g} nm")
    try:
        cusps = find_cusps(line, feed=feed, axis=axis)
    except InputError as error:
        session.echo(f"cusps: none ({error})")
        if feed is not None or nose_radius is not None:
            raise
        return flat
    session.echo(f"feed: {cusps.feed * 1e3:.4g} um with a standard uncertainty of {cusps.feed_std * 1e3:.2g} um")
    for stretch in cusps.stretches if len(cusps.stretches) > 1 or cusps.gaps else ():
        session.echo(
            f"  {stretch.feed * 1e3:.4g} um ({stretch.feed_std * 1e3:.2g} um) from {say_length(stretch.start, 4)} to "
            f"{say_length(stretch.end, 4)}, {stretch.count} crests"
        )
    for start, end in cusps.gaps:
        session.echo(f"  no cusps from {say_length(start, 4)} to {say_length(end, 4)}")
    session.echo(
        f"scallop height: mean {cusps.scallop_mean_nm:.4g} nm ({cusps.scallop_mean_std_nm:.2g} nm), median "
        f"{cusps.scallop_median_nm:.4g} nm ({cusps.scallop_median_std_nm:.2g} nm), standard deviation "
        f"{cusps.scallop_std_nm:.3g} nm of {cusps.height_nm.size}"
    )
    if nose_radius is not None:
        ideal, filtered = _predict_scallops(line, cusps.feed, nose_radius, instrument)
        through = f", {filtered:.4g} nm as measured by {instrument}" if instrument is not None else ""
        session.echo(f"ideal scallop height of a {say_length(nose_radius)} nose: {ideal:.4g} nm{through}")
    elif instrument is not None:
        raise InputError("--instrument needs --nose-radius")
    return flat


def _print_roughness(session: Session, line: Profile, cutoff: float) -> None:
    from turnwright.metrology import profile_roughness  # noqa: PLC0415
    from turnwright.units import say_length  # noqa: PLC0415

    rough = profile_roughness(line, cutoff=cutoff)
    session.echo(
        f"roughness over {rough.sections} section{'s' * (rough.sections > 1)} of {say_length(cutoff)}: "
        f"Ra {rough.ra_nm:.4g} nm, Rq {rough.rq_nm:.4g} nm, "
        f"Rz {rough.rz_nm:.4g} nm, Rsk {rough.rsk:.3g}, RSm {rough.rsm * 1e3:.4g} um"
    )


def _predict_scallops(line: Profile, feed: float, nose_radius: float, instrument: str | None) -> tuple[float, float]:
    """Return the ideal scallop height of a round nose, before and after the filter of an instrument. [nm]."""
    import numpy as np  # noqa: PLC0415

    from turnwright.instrument import Instrument  # noqa: PLC0415
    from turnwright.metrology import find_cusps  # noqa: PLC0415
    from turnwright.profile import Profile  # noqa: PLC0415

    if feed >= 2 * nose_radius:
        raise InputError(f"feed must be below {2 * nose_radius:g} mm/rev (twice the nose radius), got {feed:g} mm/rev")
    fine = line.distance[0] + line.step / 10 * np.arange(10 * (line.distance.size - 1) + 1)
    distance = np.abs(fine / feed % 1 - 0.5) * feed  # from the nearest revolution
    z = nose_radius - np.sqrt(nose_radius**2 - (feed / 2 - distance) ** 2)
    cusps = Profile(distance=fine, z=z, x=fine, y=0 * fine)
    ideal = 1e6 * (nose_radius - float(np.sqrt(nose_radius**2 - feed**2 / 4)))
    if instrument is None:
        return ideal, ideal
    return ideal, find_cusps(Instrument.load(instrument).see(cusps, like=line), feed=feed).scallop_median_nm
