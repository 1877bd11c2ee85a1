"""Build the documentation as one version of a site, beside those that are there.

    python docs/site_of_versions.py SITE
    python docs/site_of_versions.py SITE --list   # only write the list again, as after a version was deleted

The pages of this version go to ``SITE/VERSION``. ``SITE/versions.json`` names the versions that are there, newest
first, and ``SITE/index.html`` links them. Each page names its version, and links that list.
"""

import json
import re
import subprocess
import sys
from html import escape
from pathlib import Path

import glucoloop

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>glucoloop: versions of the documentation</title>
<style>
:root { color-scheme: light dark; }
body { font: 1rem/1.6 sans-serif; max-width: 40rem; margin: 2rem auto; padding: 0 1rem; }
</style>
<h1>glucoloop</h1>
<p>Research software, not a medical device. The documentation of each version, newest first:</p>
<ul>
%s
</ul>
</html>
"""


def order(version: str) -> tuple[tuple[int, ...], bool, str]:
    """What versions are sorted by: their numbers, and a release after what was published before it, as 1.0.0rc1."""
    numbers, rest = re.fullmatch(r"([\d.]*)(.*)", version).groups()
    return tuple(int(number) for number in numbers.split(".") if number), not rest, rest


def versions(site: Path) -> list[str]:
    """Versions whose pages are in a site, newest first."""
    return sorted((page.parent.name for page in site.glob("*/index.html")), key=order, reverse=True)


def write_list(site: Path) -> None:
    """Write what names the versions: `versions.json` for programs, and `index.html` for people."""
    result = versions(site)
    entries = [{"version": version, "path": f"{version}/index.html"} for version in result]
    links = [f'<li><a href="{escape(entry["path"])}">{escape(entry["version"])}</a></li>' for entry in entries]
    (site / "versions.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
    (site / "index.html").write_text(PAGE % "\n".join(links), encoding="utf-8")


def build(site: Path) -> None:
    """Build the pages of this version, with a link to the list."""
    docs = Path(__file__).resolve().parent
    place = site / glucoloop.__version__
    subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", "-t", "versions", str(docs), str(place)], check=True
    )


def main(arguments: list[str]) -> None:
    if not arguments or arguments[1:] not in ([], ["--list"]):
        raise SystemExit("give the folder of the site: python docs/site_of_versions.py SITE [--list]")
    site = Path(arguments[0])
    if not arguments[1:]:
        build(site)
    write_list(site)


if __name__ == "__main__":
    main(sys.argv[1:])
