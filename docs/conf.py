"""How the documentation is built: `make docs` writes build/docs/index.html, without a network.

The source folder is the repository: pages of docs/ and of analyses/ link to each other by paths
that hold in the repository too.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "_extensions"), str(DOCS.parent)]
# Tutorials run in processes of their own, in a folder that is thrown away.
os.environ["PYTHONPATH"] = os.pathsep.join([str(DOCS.parent), os.environ.get("PYTHONPATH", "")])
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Compiled code of the tutorials, beside the pages: nothing is written to the cache of the user.
os.environ.setdefault("BAYES_INERTIA_CACHE", str(DOCS.parent / "build" / "docs_compiled"))

from numpydoc.xref import DEFAULT_LINKS  # noqa: E402

import bayes_inertia  # noqa: E402

project = "bayes_inertia"
author = "The bayes_inertia developers"
copyright = f"2026, {author}"
release = version = bayes_inertia.__version__

root_doc = "docs/index"
include_patterns = ["docs/**", "analyses/*.md", "analyses/results/*/*.md", "C*.md"]
exclude_patterns = ["docs/_*", ".*", "build", "dist", "**/__pycache__", "tests", "bayes_inertia"]
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "command_manual",
    "mathml",
]

# Pages: Markdown with definitions, dollar mathematics and anchors of headings.
myst_enable_extensions = ["deflist", "dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = [
    "myst.header",  # Committed studies begin with a second level here and there.
    "myst-nb.lexer",  # The language of a cell is known only where it is executed.
]

# Tutorials: Markdown that is executed, unless TUTORIALS=off; an error in a cell ends the build.
nb_execution_mode = os.environ.get("TUTORIALS", "auto")
nb_execution_timeout = 600
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

# Reference: the public names, as their docstrings describe them.
default_role = "code"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True  # "library=LIBRARY", not all its members.
autodoc_default_options = {"members": True}
autosummary_generate = False
numpydoc_show_class_members = False
nitpicky = True
# Types in docstrings are links where they are public classes. Those of other packages would need a
# network.
DEFAULT_LINKS.clear()
nitpick_ignore_regex = [("py:.*", r"(?!bayes_inertia).*")]
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"
numpydoc_xref_aliases = {name: f"bayes_inertia.{name}" for name in bayes_inertia.__all__}

html_theme = "furo"
html_title = f"bayes_inertia {release}"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_extra_path = ["_extra"]
html_show_sphinx = False
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"


def _leaves_out(app, what, name, thing, skip, options):
    """Whether a member is a field of a named tuple, which its parameters describe already."""
    return skip or str(getattr(thing, "__doc__", "")).startswith("Alias for field number")


def setup(app):
    """Tell Sphinx what the reference leaves out."""
    app.connect("autodoc-skip-member", _leaves_out)
