"""How Sphinx builds the site: `make docs`, offline, warnings are errors."""

import os
import re
import runpy
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE)]

import palpate  # noqa: E402

project = "palpate"
copyright = "The palpate developers, BSD-3-Clause"
version = release = palpate.__version__
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
]
root_doc = "index"
exclude_patterns = ["_build", "gallery/*.md5", "gallery/*.py", "gallery/*.ipynb"]
templates_path = ["_templates"]
highlight_language = "text"
default_role = "code"
smartquotes = False
nitpicky = False

# Pages are Markdown that also reads well where the repository is shown.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]

# Pages are named, or a new subpackage would be overlooked beside pages built before.
MADE = runpy.run_path(str(HERE / "reference.py"))
autosummary_generate = [
    f"reference/generated/{subpackage}.rst" for subpackage in MADE["SUBPACKAGES"]
]
del MADE
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc says the types in words
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

REPOSITORY = "https://github.com/palpate/palpate"
LOGO = "_static/icon.svg"
html_search_scorer = str(HERE / "_static" / "scorer.js")
html_theme = "pydata_sphinx_theme"
html_title = "palpate"
html_static_path = [
    "_static",
    str(Path(palpate.__file__).parent / "web" / "static" / "icon.svg"),
]
html_css_files = ["palpate.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "palpate", "image_light": LOGO, "image_dark": LOGO},
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "navbar_end": ["theme-switcher", "navbar-icon-links"],
    "icon_links": [
        {"name": "Repository", "url": REPOSITORY, "icon": "fa-brands fa-github"}
    ],
    "show_prev_next": True,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": []},
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
    "show_toc_level": 1,
}
html_sidebars = {"index": [], "versions": []}

# `make linkcheck` skips our own repository, which is not public yet.
linkcheck_ignore = [
    r"https://github\.com/palpate/palpate",
    r"https?://(127\.|localhost)",
]
linkcheck_timeout = 20
linkcheck_anchors = False


# Examples that need recorded touches are shown, and run where PALPATE_DATA names them.
RECORDED = [
    path.name
    for path in sorted((HERE.parent / "examples").glob("plot_*.py"))
    if "PALPATE_DATA" in path.read_text("utf-8")
]
UNRUN = [] if os.environ.get("PALPATE_DATA") else RECORDED
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"plot_(?!" + "|".join(n[5:-3] + r"\.py" for n in UNRUN) + r")"
    if UNRUN
    else r"plot_",
    "reset_modules": ("look.one_look",),
    "image_scrapers": ("matplotlib", "look.free_figures"),
    "doc_module": ("palpate",),
    "backreferences_dir": "gallery/backreferences",
    "inspect_global_variables": True,
    "abort_on_example_error": False,
    "only_warn_on_example_error": True,
    "remove_config_comments": True,
    "capture_repr": (),
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "plot_gallery": "True",
    "write_computation_times": False,  # its page loads scripts from elsewhere
    "within_subsection_order": "FileNameSortKey",
    "default_thumb_file": str(HERE / "_static" / "recorded.png"),
}


# Plain characters of docstrings that reStructuredText would take for markup.
MARKUP = [
    (re.compile(r"(?<![\\`])\|"), r"\|"),
    (re.compile(r"(?<=[\w)\] ])(?<!\*)\*(?=[\w( ])(?!\*)"), r"\*"),
    (re.compile(r"(?<![\w`.:])(\w+)_(?=[\s,.;:)]|$)"), r"\1\_"),
]
ROLE = re.compile(r":(?:ref|term|class|func|meth|doc):`([^`<]+?)\s*(?:<[^>]*>)?`")
NAMES = re.compile(r"\s*[\w*, ]+ : ")


def plain(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Escape markup in the plain words of docstrings; code in them stays as it is."""
    for number, line in enumerate(lines):
        if line.lstrip().startswith((">>>", "...", ".. ")) or "``" in line:
            continue
        named = NAMES.match(line)
        start = named.end() if named else 0
        words = ROLE.sub(r"\1", line[start:]).split("`")
        for odd, part in enumerate(words):
            for pattern, escaped in MARKUP if odd % 2 == 0 else ():
                part = pattern.sub(escaped, part)
            words[odd] = part
        lines[number] = line[:start] + "`".join(words)


def setup(app: Any) -> None:
    """Write the pages that are made from the code before they are read."""
    app.connect("autodoc-process-docstring", plain, priority=400)
    pages = runpy.run_path(str(HERE / "reference.py"))
    pages["write_generated"](HERE / "reference" / "generated")
