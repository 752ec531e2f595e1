"""``scenec run``: compile and render."""

from __future__ import annotations

import argparse

from scenec.cli import compile_command, render_command
from scenec.cli.output import print_json


def run(options: argparse.Namespace) -> int:
    """Compiles and renders."""
    from scenec.backends.registry import require_name

    # A misspelled backend should not cost a compilation.
    require_name(options.backend)
    compiled = compile_command.compile_now(options)
    rendered = render_command.render_now(options)
    if options.json:
        print_json(
            {
                "compile": compile_command.as_json(compiled),
                "render": render_command.as_json(rendered),
            }
        )
    return 1 if rendered.failed else 0
