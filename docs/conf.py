"""Settings of the documentation: Markdown pages, no network needed to build or to read them."""

from __future__ import annotations

import towtank

project = "towtank"
version = release = towtank.__version__
html_title = f"towtank {version}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
nitpicky = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_numpy_docstring = False

html_theme = "furo"
html_copy_source = False
html_show_copyright = False
