"""The command that shows a measurement without its job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turnwright.cli.shared import Door, app, require_new
from turnwright.errors import InputError

if TYPE_CHECKING:
    from turnwright.heightmap import HeightMap
    from turnwright.profile import Profile

__all__: list[str] = []

PICTURES = (".png", ".svg", ".pdf")
File = Annotated[Path, typer.Argument(metavar="MAP", help="What the instrument wrote.", show_default=False)]


@app.command()
def show(
    context: typer.Context,
    file: File,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw it into a .png, .svg or .pdf.", show_default=False)
    ] = None,
    form: Annotated[
        str, typer.Option(help='Taken off first: "none", "mean", "plane", "sphere" or a degree; of a profile a degree.')
    ] = "plane",
    unit: Annotated[str | None, typer.Option(help='Of the heights of a text that states none, such as "um".')] = None,
    lateral_unit: Annotated[str | None, typer.Option(help="The same of x and y, or of the distance.")] = None,
    pixel_size: Annotated[str | None, typer.Option(help='Where the file does not say, such as "0.87 um".')] = None,
    profile: Annotated[bool, typer.Option("--profile", help="The file holds a profile, not a map.")] = False,
    distance: Annotated[str | None, typer.Option(help="Column of a profile's distance.")] = None,
    height: Annotated[str | None, typer.Option(help="Column of a profile's height.")] = None,
    number: Annotated[int | None, typer.Option(min=1, help="Which profile of several.")] = None,
    cutoff: Annotated[str | None, typer.Option(help='L-filter of a profile\'s roughness, such as "0.08 mm".')] = None,
    feed: Annotated[str | None, typer.Option(help='First guess of a profile\'s feed, such as "10 um/rev".')] = None,
    axis: Annotated[
        str | None, typer.Option(help='Where a profile crosses the spindle axis, such as "0.4 mm".')
    ] = None,
    nose_radius: Annotated[
        str | None, typer.Option(help='Predict the scallops of a perfect nose, such as "0.2 mm".')
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(help="Through which the prediction is seen: a name, or a .toml file.")
    ] = None,
) -> None:
    """Show a measured map or profile by itself: header, size, missing heights, Sq or scallops."""
    door: Door = context.obj
    from turnwright.metrology import level, overview  # noqa: PLC0415 - costly
    from turnwright.units import parse  # noqa: PLC0415

    if picture is not None:
        if picture.suffix.lower() not in PICTURES:
            raise InputError(f"the picture is {picture.name!r}, it can end in {', '.join(PICTURES)}: name it so")
        require_new(picture)
    kind = int(form) if form.isdigit() else form

    def stated(quantity: str | None, unit: str = "mm") -> float | None:
        return None if quantity is None else parse(quantity, unit)

    if profile or distance is not None or height is not None or number is not None:
        from turnwright.files import read_profile  # noqa: PLC0415

        if pixel_size is not None:
            raise InputError("a profile has distances, not pixels: leave --pixel-size out, or state --lateral-unit")
        line = read_profile(file, distance=distance, height=height, unit=unit, lateral_unit=lateral_unit, number=number)
        drawn: HeightMap | Profile = _show_profile(
            door, line, kind, stated(feed, "mm/rev"), stated(axis), stated(nose_radius), instrument,
        )  # fmt: skip
        if cutoff is not None:
            _say_roughness(door, line, parse(cutoff, "mm"))
    else:
        from turnwright.files import read_map  # noqa: PLC0415

        if any(one is not None for one in (nose_radius, instrument, feed, axis, cutoff)):
            raise InputError(
                "axis, cutoff, feed, nose and instrument are for a profile: add --profile, or leave them out"
            )
        heights = read_map(
            file, unit=unit, lateral_unit=lateral_unit,
            pixel_size=stated(pixel_size),
        )  # fmt: skip
        door.say(heights.name)
        for name, value in overview(heights, kind):
            door.say(f"{name}: {value}")
        drawn = level(heights, kind) if picture is not None else heights
    if picture is not None:
        from turnwright.report import write_picture  # noqa: PLC0415

        write_picture(drawn, picture)
        door.say(f"picture: {picture}")


def _show_profile(
    door: Door,
    line: Profile,
    form: str | int,
    feed: float | None,
    axis: float | None,
    nose_radius: float | None,
    instrument: str | None,
) -> Profile:
    """Say what a profile shows, and return it without its form."""
    import numpy as np  # noqa: PLC0415

    from turnwright.metrology import find_cusps, without_form  # noqa: PLC0415 - costly to import
    from turnwright.units import say_length  # noqa: PLC0415

    flat = without_form(line, form)
    missing = int(np.count_nonzero(np.isnan(line.z)))
    length = float(np.ptp(line.distance))
    door.say(line.name)
    door.say(
        f"size: {line.z.size} points, {say_length(length / max(line.z.size - 1, 1), 4)} apart, {say_length(length, 4)}"
    )
    door.say(f"missing: {missing} of {line.z.size} ({100 * missing / line.z.size:.3g} %)")
    door.say(f"Pq: {flat.pq_nm:.4g} nm, Pt: {flat.pt_nm:.4g} nm")
    try:
        cusps = find_cusps(line, feed=feed, axis=axis)
    except InputError as error:
        door.say(f"cusps: none ({error})")
        if feed is not None or nose_radius is not None:
            raise
        return flat
    door.say(f"feed: {cusps.feed * 1e3:.4g} um with a standard uncertainty of {cusps.feed_std * 1e3:.2g} um")
    for one in cusps.stretches if len(cusps.stretches) > 1 or cusps.gaps else ():
        door.say(
            f"  {one.feed * 1e3:.4g} um ({one.feed_std * 1e3:.2g} um) from {say_length(one.start, 4)} to "
            f"{say_length(one.end, 4)}, {one.count} crests"
        )
    for start, end in cusps.gaps:
        door.say(f"  no cusps from {say_length(start, 4)} to {say_length(end, 4)}")
    door.say(
        f"scallop height: mean {cusps.scallop_mean_nm:.4g} nm ({cusps.scallop_mean_std_nm:.2g} nm), median "
        f"{cusps.scallop_median_nm:.4g} nm ({cusps.scallop_median_std_nm:.2g} nm), standard deviation "
        f"{cusps.scallop_std_nm:.3g} nm of {cusps.height_nm.size}"
    )
    if nose_radius is not None:
        bare, seen = _predicted(line, cusps.feed, nose_radius, instrument)
        through = f", {seen:.4g} nm as seen by {instrument}" if instrument is not None else ""
        door.say(f"a perfect nose of {say_length(nose_radius)} leaves scallops of {bare:.4g} nm{through}")
    elif instrument is not None:
        raise InputError("an instrument sees a prediction: state --nose-radius too")
    return flat


def _say_roughness(door: Door, line: Profile, cutoff: float) -> None:
    from turnwright.metrology import profile_roughness  # noqa: PLC0415
    from turnwright.units import say_length  # noqa: PLC0415

    rough = profile_roughness(line, cutoff=cutoff)
    door.say(
        f"roughness over {rough.sections} section{'s' * (rough.sections > 1)} of {say_length(cutoff)}: "
        f"Ra {rough.ra_nm:.4g} nm, Rq {rough.rq_nm:.4g} nm, "
        f"Rz {rough.rz_nm:.4g} nm, Rsk {rough.rsk:.3g}, RSm {rough.rsm * 1e3:.4g} um"
    )


def _predicted(line: Profile, feed: float, nose_radius: float, instrument: str | None) -> tuple[float, float]:
    """Return the scallop heights of a perfect nose, as they are and as an instrument shows them."""
    import numpy as np  # noqa: PLC0415

    from turnwright.instrument import Instrument  # noqa: PLC0415
    from turnwright.metrology import find_cusps  # noqa: PLC0415
    from turnwright.profile import Profile  # noqa: PLC0415

    if feed >= 2 * nose_radius:
        raise InputError(
            f"the feed is {feed:g} mm, the limit is the width of the nose, {2 * nose_radius:g} mm: correct it"
        )
    fine = line.distance[0] + line.step / 10 * np.arange(10 * (line.distance.size - 1) + 1)
    off = np.abs(fine / feed % 1 - 0.5) * feed  # from the nearest pass
    made = Profile(distance=fine, z=nose_radius - np.sqrt(nose_radius**2 - (feed / 2 - off) ** 2), x=fine, y=0 * fine)
    bare = 1e6 * (nose_radius - float(np.sqrt(nose_radius**2 - feed**2 / 4)))
    if instrument is None:
        return bare, bare
    return bare, find_cusps(Instrument.load(instrument).see(made, like=line), feed=feed).scallop_median_nm
