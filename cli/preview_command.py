"""``scenec preview``: a page that shows what a cfg makes, and follows the file."""

from __future__ import annotations

import argparse
import webbrowser

from scenec.api.preview import PreviewOptions, live_preview, write_preview
from scenec.cli.compile_command import cache_of
from scenec.cli.output import say


def run(options: argparse.Namespace) -> int:
    """Shows the cfg until it is interrupted; with ``--once`` writes the page and ends.

    Raises:
        CfgError, ScenecError: With ``--once``, what is wrong; else the page says it.
    """
    shown = PreviewOptions(
        settings=options.settings,
        seed=options.seed,
        backend=options.backend,
        spp=options.spp,
        width=options.width,
        cache=cache_of(options),
    )
    if options.once:
        write_preview(options.cfg, options.once, shown)
        print(f"preview: {options.once}")
        return 0
    with live_preview(options.cfg, shown, port=options.port, say=say) as (address, preview):
        say(f"preview of {options.cfg}: {address} (Ctrl-C ends it)")
        if not options.no_browser:
            webbrowser.open(address)
        preview.follow()
    return 0
