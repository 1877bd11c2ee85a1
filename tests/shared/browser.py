"""What tests of pages need beside Python: node, Chromium, and the packages of npm that `.ci/tools` installs."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
_INSTALLED = Path(__file__).parents[1] / "browser" / "node_modules"
MODULES = os.environ.get("GLUCOLOOP_NODE_MODULES") or (str(_INSTALLED) if _INSTALLED.is_dir() else None)

needs_modules = pytest.mark.skipif(
    not (NODE and MODULES), reason="needs node and the packages of npm: `npm ci --prefix tests/browser`"
)
needs_browser = pytest.mark.skipif(
    not (NODE and MODULES and CHROMIUM),
    reason="needs node, chromium (Debian's packages nodejs, chromium), and `npm ci --prefix tests/browser`",
)


def in_browser(script, *arguments):
    """Answer in JSON of a script that drives Chromium; it gets the browser, the packages, and then its arguments."""
    command = [NODE, script, CHROMIUM, MODULES, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=550, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
