"""The site that `make docs` builds of these pages. Warnings are errors: a link to what is not there ends the build."""

import importlib.metadata
import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parents[1]))

from tools import docs_reference, try_page

docs_reference.main()

PLACES = {  # of pages that lie elsewhere in the repository, where a reader of the files finds them
    "../firmware/README.md": "firmware.md",
    "../firmware/rosserial/README.md": "board-library.md",
    "../tests/captures/README.md": "captures.md",
    "../CONTRIBUTING.md": "design.md",
}

project = "hostlink"
release = importlib.metadata.version("hostlink")
copyright = "the authors of hostlink, MIT licence"  # noqa: A001 - Sphinx's name
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["examples"]
html_theme = "furo"
html_title = f"hostlink {release}"
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False
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
    """Links to what lies elsewhere lead to its page here; and the page that drives the firmware is beside them."""
    app.connect("source-read", _link_here)
    app.connect("build-finished", _write_try_page)


def _write_try_page(app: Sphinx, _error: Exception | None) -> None:
    try_page.write(Path(app.outdir) / "try.html")


def _link_here(_app: Sphinx, _page: str, source: list[str]) -> None:
    for place, page in PLACES.items():
        source[0] = source[0].replace(f"]({place}", f"]({page}")
