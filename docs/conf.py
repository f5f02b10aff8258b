"""Settings of the documentation: Markdown pages, no network needed to build or to read them.

Notebooks are executed while it is built, and again only when they change; without MyST-NB they are left out.
"""

from __future__ import annotations

from importlib.util import find_spec

import towtank

project = "towtank"
version = release = towtank.__version__
html_title = f"towtank {version}"

notebooks = find_spec("myst_nb") is not None
extensions = ["myst_nb" if notebooks else "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", *([] if notebooks else ["notebooks"])]
suppress_warnings = [] if notebooks else ["toc.excluded", "toc.not_readable"]
nitpicky = False

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # s, of a cell; they take 20 at most once kernels are compiled
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_numpy_docstring = False

html_theme = "furo"
html_copy_source = False
html_show_copyright = False
