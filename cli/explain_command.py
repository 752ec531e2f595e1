"""``scenec explain``: errors, costs, what was left out, and why one thing is there or not."""

from __future__ import annotations

import argparse
import shutil

from scenec.api.explain.explanation import WIDTH, explain
from scenec.cli.output import print_json, say_next

#: Columns of what is printed on the narrowest terminal.
_NARROWEST = 80


def run(options: argparse.Namespace) -> int:
    """Prints the reports of all batches, or one answer, or what a scene's ladders measure."""
    if options.ladder:
        from scenec.cli.explain_ladder import run as run_ladder

        return run_ladder(options)
    if options.why is not None:
        from scenec.api.explain.why import why

        answer = why(options.out, options.why, options.batch)
        if options.json:
            print_json(answer.as_json())
        else:
            print(answer.text)
        return 0
    found = explain(options.out, options.batch)
    if options.json:
        print_json(found.as_json())
        return 0
    width = max(min(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH), _NARROWEST)
    print(found.text(width))
    say_next(("explain --why CLASS/NUMBER", options.out))
    return 0
