"""Sphinx configuration. Build with: python3 dev long, or sphinx-build -W docs docs/_build/html."""

import os
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent / "src"), str(DOCS.parent / "tests/shared")]

from quick_to_compile import CACHE, keep_compiled, set_flags, share_contexts  # noqa: E402

(DOCS / "_build").mkdir(exist_ok=True)
# before anything is computed: each program of the pictures runs once
set_flags(os.environ.get(CACHE, DOCS / "_build"))
share_contexts()
if CACHE in os.environ:
    keep_compiled(os.environ[CACHE])  # many are those of tests

import generate  # noqa: E402
import pictures  # noqa: E402

import glucoloop  # noqa: E402

generate.write_all(DOCS)
pictures.make_all(DOCS)

project = "glucoloop"
author = "The glucoloop authors"
copyright = "the glucoloop authors, MIT licence"
version = release = glucoloop.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "mathml",
    "annotations",
    "offline",
    "page_sizes",
    "short_names",
]
exclude_patterns = ["_build", "_generated", "_pictures", "_templates", *generate.included(DOCS)]
suppress_warnings = ["config.cache", "ref.python"]  # ref.python: a short name that two objects have

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

smartquotes = False  # --noise is not –noise
highlight_language = "text"
add_module_names = False
toc_object_entries = False  # every page carries the contents of all, and with each function they are long

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}
autodoc_preserve_defaults = True
autodoc_mock_imports = ["stable_baselines3"]  # the one extra that brings gigabytes
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
default_role = "py:obj"  # as in the docstrings: `name` is a link where there is something to link to

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"glucoloop {release}"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["glucoloop.css"]
html_use_index = False  # one page of 800 kB; the search finds names
html_last_updated_fmt = "%Y-%m-%d"  # numbers that are made with the pages are of this day
templates_path = ["_templates"]
if tags.has("versions"):  # noqa: F821 - Sphinx has it here; see site_of_versions.py
    html_sidebars = {
        "**": [
            "sidebar/brand.html",
            "versions.html",
            "sidebar/search.html",
            "sidebar/scroll-start.html",
            "sidebar/navigation.html",
            "sidebar/scroll-end.html",
        ]
    }
