"""``scenec preview``: a page that shows what a cfg makes, and follows the file."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from scenec.api.options import PreviewOptions
from scenec.api.preview import live_preview, preview
from scenec.cli.arguments import chosen, given
from scenec.cli.output import say
from scenec.cli.terminal import Terminal
from scenec.schemas.files import check_output


def run(options: argparse.Namespace) -> int:
    """Shows the cfg until it is interrupted; with ``--once`` writes the page and ends.

    Raises:
        CfgError, ScenecError: With ``--once``, what is wrong; else the page says it.
    """
    if options.once:
        check_output(Path(options.once))
        preview(options.cfg, **chosen(PreviewOptions, options)).save(options.once)
        print(f"preview: {options.once}")
        return 0
    asked = given(PreviewOptions, options, listener=Terminal())
    with live_preview(options.cfg, asked, port=options.port) as (address, following):
        say(f"preview of {options.cfg}: {address} (Ctrl-C ends it)")
        if not options.no_browser:
            webbrowser.open(address)
        following.follow()
    return 0
