"""The site that `make docs` builds of these pages. Warnings are errors: a link to what is not there ends the build."""

import importlib.metadata
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parents[1]))

from tools import docs_reference, try_page

docs_reference.main()

OUTSIDE = re.compile(r"\]\((\.\./[^)#\s]+\.md)(?:#[^)\s]*)?\)")  # links to Markdown files of the repository

project = "hostlink"
release = importlib.metadata.version("hostlink")
copyright = "the authors of hostlink, MIT licence"  # noqa: A001 - Sphinx's name
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["examples"]
html_theme = "furo"
html_title = f"hostlink {release}"
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["print.css"]
default_role = "code"  # docstrings write code as Markdown does
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
myst_links_external_new_tab = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
python_use_unqualified_type_names = True
suppress_warnings = ["misc.highlighting_failure"]


def setup(app: Sphinx) -> None:
    """Links to documents of the repository lead to a copy; and the page that drives the firmware is beside them."""
    app.connect("source-read", _link_to_file)
    app.connect("build-finished", _write_try_page)


def _write_try_page(app: Sphinx, _error: Exception | None) -> None:
    try_page.write(Path(app.outdir) / "try.html")


def _link_to_file(_app: Sphinx, _page: str, source: list[str]) -> None:
    """A Markdown file outside this folder is no page here: a reader downloads it, without a section."""
    source[0] = OUTSIDE.sub(r"](path:\1)", source[0])
