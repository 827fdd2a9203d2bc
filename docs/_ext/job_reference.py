"""Writes the page of every table and key of a job file, from the classes that read it, before the pages are read."""

from pathlib import Path

from turnwright.job import job_schema, reference_tables

HEAD = """# Job-file reference

Every table and key of a job file, generated from the classes that read the file. How to write one:
[write a job file](howto/job_file.md). Quantities are text with a unit (`"8 um/rev"`); a bare number is refused where a
unit is needed. Keys in **bold** must be stated.

| table | explained in |
|---|---|
"""

EXPLAINED = {
    "part": "[state the blank](howto/blank.md), [add a material](howto/material_file.md), "
    "[measure and correct](howto/measure_and_correct.md) for `correction`",
    "part.surface": "[surfaces](theory/surfaces.md), [cut from a table of heights](howto/sag_table.md), "
    "[cut an off-axis part](howto/off_axis.md)",
    "tool": "[tool and access](theory/access.md), "
    "[describe the measurement](howto/measurement_setup.md) for `plausible`",
    "machine": "[add a machine](howto/machine_file.md)",
    "strategy": "[which strategy for which part](howto/choose_strategy.md), [points](howto/points.md)",
    "passes": "[state the blank](howto/blank.md), [cut a brittle material](howto/brittle_material.md)",
    "simulation": "[tracking](theory/tracking.md)",
    "actual": "[simulate the actual tool](howto/actual_tool.md)",
    "roughness": "[roughness](theory/roughness.md)",
    "tolerances": "[tolerances](howto/tolerance.md), [exit codes](command_line.md#exit-codes)",
    "measurement": "[describe the measurement](howto/measurement_setup.md), [registration](theory/registration.md), "
    "[diagnosis](theory/diagnosis.md)",
    "program": "[programs](theory/program.md), [fast tools](theory/fast_tool.md), [tracking](theory/tracking.md)",
}
"""The pages that explain a table, by its name."""


def page() -> str:
    """Return the page as Markdown."""
    lines = [HEAD + "\n".join(f"| {_brackets(place)} | {pages} |" for place, pages in EXPLAINED.items()), ""]
    accepted = job_schema()["properties"]["accept"]
    names = ", ".join(f'"{name}"' for name in accepted["items"]["enum"])
    lines += [f"In front of all tables: `accept`, a list of any of {names}. {accepted['description']}", ""]
    for table in reference_tables():
        named = next((key.line for key in table.keys if key.name in ("family", "kind")), "")
        lines += [f"## {_brackets(table.place)}" + (f", `{named}`" if named else ""), "", table.text, ""]
        lines += ["| key | type | limits | default | what it is | example |", "|---|---|---|---|---|---|"]
        for key in table.keys:
            name = f"**`{key.name}`**" if key.required else f"`{key.name}`"
            cells = [name, key.takes, key.limits, f"`{key.default}`" if key.default else "", key.text]
            cells.append(f"`{key.line}`" if key.line else "")
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines)


def _brackets(place: str) -> str:
    """Return the name of a table as it stands in a file: double brackets for a list of tables."""
    return f"`[[{place}]]`" if place in ("passes", "simulation.patches") else f"`[{place}]`"


def _write(app: object) -> None:
    file = Path(app.srcdir) / "job_file_reference.md"
    if not file.is_file() or file.read_text(encoding="utf-8") != page():
        file.write_text(page(), encoding="utf-8")


def setup(app: object) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
