"""The wheel and the source distribution of a tag, made in a clean clone, or a sentence that says why not.

What is checked, in this order: the tag is of the commit that is checked out, nothing is changed beside it,
`__version__` and CITATION.cff say what the tag says, CHANGELOG.md has a section of that version with its date, two
builds in two clones have the same bytes, and `.ci/run` succeeds in a clone. What a run of it wrote, with its commit at
the head and its exit status at the end, may be given in its place: such a log is taken at its word, so keep it with
the release.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from environment import ROOT, say, stop

FOLDER = "dist"
COMMIT, STATUS = "commit ", "exit status "
VERSION = re.compile(r'^__version__ = "([^"]+)"$', re.MULTILINE)
CITED = re.compile(r"^version: (\S+)$", re.MULTILINE)


def refuse(why: str) -> None:
    stop(f"no release: {why}", 2)


def git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        stop(f"git {words[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip()


def tagged(root: Path, tag: str) -> str:
    """The commit of a tag, if it is checked out and nothing is changed."""
    tags = git(root, "tag", "--list").split()
    if tag not in tags:
        known = ", ".join(tags) or "none"
        refuse(f"there is no tag {tag!r} (there is: {known}). Make it with: git tag -a {tag}")
    commit = git(root, "rev-parse", f"refs/tags/{tag}^{{commit}}")
    if git(root, "rev-parse", "HEAD") != commit:
        refuse(f"{tag} is {commit[:12]}, which is not checked out. Do that with: git checkout {tag}")
    changed = git(root, "status", "--porcelain").splitlines()
    if changed:
        refuse(
            f"the tree is not clean; {len(changed)} files differ from {tag} or are new, as {changed[0].split()[-1]}."
        )
    return commit


def agreed(clone: Path, tag: str) -> str:
    """The version that tag, package, citation and list of changes agree on."""
    version = tag.removeprefix("v")
    for name, pattern in (("src/glucoloop/__init__.py", VERSION), ("CITATION.cff", CITED)):
        said = pattern.search((clone / name).read_text(encoding="utf-8"))
        if said is None or said[1] != version:
            told = "no version" if said is None else f"version {said[1]}"
            refuse(f"{name} has {told} and the tag is {tag!r}, which wants {version}.")
    section = rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$"
    if not re.search(section, (clone / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE):
        refuse(f"CHANGELOG.md has no section '## [{version}] - ' with the date of the release.")
    return version


def cloned(root: Path, tag: str, folder: Path) -> Path:
    git(root, "clone", "--quiet", "--no-hardlinks", "--branch", tag, str(root), str(folder))
    return folder


def built(clone: Path, python: str, dated: str) -> dict[str, bytes]:
    """Wheel and source distribution of a clone, by name."""
    command = [python, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(clone / FOLDER)]
    variables = {**os.environ, "SOURCE_DATE_EPOCH": dated}
    done = subprocess.run(command, cwd=clone, env=variables, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        stop(f"hatchling failed:\n{done.stdout}{done.stderr}")
    return {path.name: path.read_bytes() for path in sorted((clone / FOLDER).iterdir())}


def carry_out_checks(clone: Path, commit: str, log: Path) -> None:
    """Carry out `.ci/run` in a clone; what it says goes to the terminal and into the log."""
    say(f"Carrying out .ci/run on {commit[:12]}; what it says is kept in {log}")
    with (
        log.open("w", encoding="utf-8") as kept,
        subprocess.Popen(
            [str(clone / ".ci" / "run")],
            cwd=clone,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
        ) as running,
    ):
        kept.write(f"{COMMIT}{commit}\n.ci/run, begun {time.strftime('%Y-%m-%d %H:%M UTC', time.gmtime())}\n")
        for line in running.stdout or ():
            kept.write(line)
            print(line, end="", flush=True)
        kept.write(f"\n{STATUS}{running.wait()}\n")


def green(log: Path, commit: str) -> None:
    """Stop unless a log is of this commit, and of checks that all succeeded."""
    try:
        lines = log.read_text(encoding="utf-8").splitlines() or [""]
    except OSError as error:
        refuse(f"the log {log} cannot be read ({error.strerror}).")
    if lines[0] != f"{COMMIT}{commit}":
        refuse(f"the log {log} is not of this commit; its first line is {lines[0]!r} and should be '{COMMIT}{commit}'.")
    if lines[-1] != f"{STATUS}0":
        refuse(f".ci/run was not green: the log {log} ends with {lines[-1]!r} and not with '{STATUS}0'.")


def write(folder: Path, files: dict[str, bytes]) -> None:
    """Write what was built, unless other bytes of that name are there."""
    for name, held in files.items():
        path = folder / name
        if path.exists() and path.read_bytes() != held:
            refuse(f"{path} is there with other bytes. Move it away; what was published is never replaced.")
    digests = {name: hashlib.sha256(held).hexdigest() for name, held in files.items()}
    for name, held in files.items():
        (folder / name).write_bytes(held)
    sums = "".join(f"{digest}  {name}\n" for name, digest in digests.items())
    (folder / "SHA256SUMS").write_text(sums, encoding="utf-8")
    say(sums.rstrip())


def release(tag: str, python: str, ran: Path | None, root: Path = ROOT) -> None:
    """Make the distributions of a tag in `dist`; `ran` is the log of checks that were carried out before."""
    commit = tagged(root, tag)
    folder = root / FOLDER
    with tempfile.TemporaryDirectory(prefix="glucoloop-release-") as place:
        first, second = (cloned(root, tag, Path(place) / name) for name in ("first", "second"))
        agreed(first, tag)
        dated = git(first, "log", "-1", "--format=%ct")
        files = built(first, python, dated)
        if files != built(second, python, dated):
            stop("no release: two builds of the same commit differ.")
        folder.mkdir(exist_ok=True)
        if ran is None:
            ran = folder / f"ci-run-{commit[:12]}.log"
            carry_out_checks(cloned(root, tag, Path(place) / "checked"), commit, ran)
        green(ran, commit)
    write(folder, files)
    say(f"{tag} is {commit}; .ci/run was green by {ran}")


def release_arguments(words: Sequence[str]) -> tuple[str, Path | None]:
    """The tag, and the log of a run of the checks if one is given."""
    match words:
        case [tag] if not tag.startswith("-"):
            return tag, None
        case [tag, "--ran", log] | ["--ran", log, tag] if not tag.startswith("-"):
            return tag, Path(log)
    stop("release takes a tag, like v0.1.0, and perhaps --ran LOG, which an earlier call wrote.", 2)
