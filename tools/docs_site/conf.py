# SPDX-License-Identifier: GPL-2.0-or-later
"""Sphinx's configuration of the documentation site; tools/make_docs runs it."""
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from slugs import github_slug  # noqa: E402  pylint: disable=wrong-import-position

project = "Axon"
html_title = "Axon"
copyright = "the authors of Axon"  # pylint: disable=redefined-builtin
extensions = ["myst_parser", "breathe"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
root_doc = "index"
breathe_projects = {"axon": ""}  # make_docs says where
breathe_default_project = "axon"
breathe_default_members = ("members",)
breathe_show_include = False
cpp_id_attributes = ["AXON_EI_API"]
primary_domain = "cpp"
highlight_language = "none"  # what stands in a fence without a language are commands and their output
# "--server" stays two hyphens.
smartquotes = False
suppress_warnings = ["myst.header"]  # pages may leave out a level of headings

myst_heading_anchors = 6
myst_heading_slug_func = github_slug
# In these pages '%' and '+++' at the start of a line are text.
myst_disable_syntax = ["myst_line_comment", "myst_block_break", "myst_target", "myst_role"]

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_baseurl = ""
pygments_style = "friendly"
pygments_dark_style = "monokai"
html_theme_options = {"top_of_page_button": None, "navigation_with_keys": False}
