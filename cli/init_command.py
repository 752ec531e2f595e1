"""``scenec init``."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from scenec.cli.output import print_json
from scenec.compiler.cfg.resources import packaged_files
from scenec.schemas.errors import OutputError, ScenecError
from scenec.schemas.files import atomic
from scenec.schemas.spelling import nearest


def run(options: argparse.Namespace) -> int:
    """Writes a template, or lists them.

    Raises:
        ScenecError: There is no such template.
        OutputError: The file is there, or cannot be written.
    """
    texts = {
        file.stem: file.read_text("utf-8") for file in packaged_files("configs", "templates/*")
    }
    about = {name: text.partition("\n")[0].removeprefix("// ") for name, text in texts.items()}
    if options.template is None:
        if options.json:
            print_json(about)
        else:
            print("\n".join(f"{name:<10}{text}" for name, text in about.items()))
        return 0
    text = texts.get(options.template)
    if text is None:
        raise ScenecError(f"no template {options.template!r}{nearest(options.template, texts)}")
    if options.output == "-":
        sys.stdout.write(text)
        return 0
    file = Path(options.output or f"{options.template}.jsonc")
    # A link that leads nowhere is something, too.
    if os.path.lexists(file):
        raise OutputError(f"{file}: is there already; choose another name by -o")
    with atomic(file) as temporary:
        temporary.write_text(text, encoding="utf-8")
    if options.json:
        print_json({"file": str(file), "about": about[options.template]})
    else:
        print(f"{file} written; next: scenec run {file} -o OUT, or scenec preview {file}")
    return 0
