"""What a height map says: its form, and the surface parameters of what remains."""

from turnwright.metrology.form import Form, remove_form
from turnwright.metrology.roughness import Roughness, roughness

__all__ = ["Form", "Roughness", "remove_form", "roughness"]
