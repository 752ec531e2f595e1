"""The website of these pages: Sphinx reads Markdown by MyST and dresses it by Furo. ``make site``.

Nothing is fetched, and a warning (a dead link, a page in no table of contents, a docstring that is
not well formed) fails the build.
"""

from __future__ import annotations

import re
from importlib.metadata import version as installed_version

from docutils import nodes
from pygments.lexers.data import JsonLexer
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

project = "scenec"
copyright = "the authors of scenec, Apache-2.0"
version = release = installed_version("scenec")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["example_plugins", "site"]
html_theme = "furo"
html_title = f"scenec {version}"
html_show_sourcelink = False
html_static_path = ["site"]
html_css_files = ["wide.css"]

# Links to headings are those that a forge makes of the same files.
myst_heading_anchors = 4

autodoc_typehints = "none"
autodoc_member_order = "bysource"
# Signatures name types as the source does; the extras of renderers and PyTorch need not be there.
autodoc_mock_imports = ["torch"]


class CommandHelp(SphinxDirective):
    """Sections with the ``--help`` of every command, as the parser of the command line has it."""

    def run(self) -> list[nodes.Node]:
        """One section a command."""
        import argparse
        import os

        from scenec.cli.main import parser

        os.environ["COLUMNS"] = "90"
        sections: list[nodes.Node] = []
        for action in parser()._actions:
            if isinstance(action, argparse._SubParsersAction):
                for name, command in action.choices.items():
                    section = nodes.section(ids=[f"scenec-{name}"])
                    text = command.format_help()
                    section += nodes.title("", f"scenec {name}")
                    section += nodes.literal_block(text, text, language="text")
                    sections.append(section)
        return sections


def name_what_is_outside(_app: Sphinx, _page: str, source: list[str]) -> None:
    """Links to Markdown outside of docs/, which is no page of the site, become its path."""
    source[0] = re.sub(r"\[([^\]]+)\]\(\.\./([^)#]+\.md)\)", r"\1 (`\2`)", source[0])


def setup(app: Sphinx) -> None:
    """Name the directive, and how cfgs with comments are colored; Sphinx calls this."""
    app.connect("source-read", name_what_is_outside)
    app.add_lexer("jsonc", JsonLexer)
    app.add_directive("command-help", CommandHelp)
