"""The documentation: every page is executed while it is built, and nothing is fetched."""

import logging
import os
import sys
from pathlib import Path

EXTENSIONS = str(Path(__file__).parent / "_ext")
sys.path.insert(0, EXTENSIONS)
# The pages run in processes of their own, which import `console` from there.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [EXTENSIONS, os.environ.get("PYTHONPATH")]))

logging.getLogger("traitlets").setLevel(logging.WARNING)

project = "Turnwright"
author = "The Turnwright developers"
copyright = author  # noqa: A001 - Sphinx reads this name
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "job_reference", "mathml"]
exclude_patterns = ["_build", "jupyter_execute"]

# Pages are executed each time, and one that raises fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # seconds of one cell, of which a busy machine may need many
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3

# Docstrings are numpydoc with one section of our own.
napoleon_google_docstring = False
napoleon_custom_sections = ["Sources"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
default_role = "py:obj"

html_theme = "furo"
html_title = "Turnwright"
html_math_renderer = "mathml"
html_copy_source = False
