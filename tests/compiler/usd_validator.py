"""What a validator that is not ours says of a stage."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from scenec.schemas import materialx


def independent_findings(stage: Path, report: Path) -> set[tuple[str, str]]:
    """(severity, rule) of everything that usd-validation-nvidia finds.

    But MaterialX nodes: usd-core, which it works on, has no library of them.
    """
    # Its exit status is 1 for warnings, too: the report tells them apart.
    subprocess.run(
        [sys.executable, "-m", "usd_validation_nvidia", "--json-output", str(report), str(stage)],
        check=False,
        capture_output=True,
    )
    rules = json.loads(report.read_text())["rules"]
    issues = [issue for rule in rules for issue in rule.get("issues", [])]
    unknown = [f"shaderId '{node}' specified on" for node in materialx.NODES]
    return {
        (issue["severity"], issue["rule"]["name"])
        for issue in issues
        if not any(issue["message"].startswith(words) for words in unknown)
    }
