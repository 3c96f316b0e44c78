"""The documentation: `make docs` writes docs/_build/html. Nothing is fetched, when it is built or read."""

import os
import sys
import warnings
from pathlib import Path

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
os.environ.setdefault("MPLBACKEND", "agg")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "tests"), str(HERE.parent)]

import armflex

project = "armflex"
author = copyright = "the armflex authors"
version = release = armflex.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "made",
]
exclude_patterns = ["_build", "_made/*.md", "results", "notebooks", "formats", "paper"]
templates_path: list[str] = []

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
smartquotes = False  # examples are copied from these pages
suppress_warnings = [
    "config.cache",  # of the gallery, whose order of pages is a function
    "ref.python",  # attributes of one name in several classes, where an attribute is listed
]

default_role = "code"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
napoleon_use_ivar = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = "armflex"
html_static_path = ["_static"]
html_css_files = ["armflex.css"]
html_copy_source = html_show_sourcelink = False
html_theme_options = {"sidebar_hide_name": False}
pygments_style = "tango"
pygments_dark_style = "monokai"

sphinx_gallery_conf = {
    "examples_dirs": "notebooks",
    "gallery_dirs": "_made/notebooks",
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__\.py",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "capture_repr": ("_repr_html_",),
    "min_reported_time": 1e9,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "only_warn_on_example_error": False,
    "abort_on_example_error": True,
    "remove_config_comments": True,
}

warnings.filterwarnings("ignore", category=armflex.ArmflexWarning)
