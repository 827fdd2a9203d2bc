"""What a height map says: its form, and the surface parameters of what remains."""

from turnwright.metrology.clean import Despiked, Filled, despike, fill_holes, keep_disc, trim_edge
from turnwright.metrology.filters import Bands, Nesting, filter_map, separate_bands
from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.roughness import Roughness, roughness

__all__ = [
    "Bands",
    "Despiked",
    "Filled",
    "Form",
    "Nesting",
    "Roughness",
    "despike",
    "fill_holes",
    "filter_map",
    "keep_disc",
    "remove_form",
    "roughness",
    "separate_bands",
    "trim_edge",
]
