"""``glucoloop export``: the folder that an engineer gets, and its checks."""

import json
import os
import shutil
import subprocess
import tomllib

import pytest

from glucoloop.cli.app import main
from glucoloop.native.targets.c.host import compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler: install gcc")

QEMU = ("arm-none-eabi-gcc", "qemu-system-arm")


def call(*arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return left.value.code


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("chip") / "out"
    target = "cortex-m4f" if all(map(shutil.which, QEMU)) else "c"
    assert call("export", "--controller", "basal", "--guard", "--target", target, "--samples", "60", "--out", path) == 0
    return path


@pytest.mark.long
@pytest.mark.parametrize("command", ["sha256sum -c SHA256SUMS", "make test", "make qemu"])
def test_the_folder_passes_its_own_test_elsewhere(folder, tmp_path, command):
    program = command.split()[0]
    for tool in (program, *(QEMU if "qemu" in command else ())):
        if shutil.which(tool, path=os.defpath) is None:
            pytest.skip(f"no {tool} on this machine")
    place = shutil.copytree(folder, tmp_path / "elsewhere")
    # Nothing of this project can be found there.
    ran = subprocess.run(
        command.split(), cwd=place, env={"PATH": os.defpath}, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert program != "make" or "samples=60 wrong=0" in ran.stdout + ran.stderr


@pytest.mark.long
def test_a_changed_dose_is_found(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "copy")
    place = tmp_path / "copy" / "controller.c"
    text = place.read_text()
    assert "decision->insulin_mU_min = v" in text
    place.write_text(text.replace("decision->insulin_mU_min = v", "decision->insulin_mU_min = 0x1.000002p+0F * v"))
    (tmp_path / "copy" / "selftest").unlink(missing_ok=True)
    ran = subprocess.run(["make", "test"], cwd=tmp_path / "copy", capture_output=True, text=True, check=False)
    assert ran.returncode != 0
    assert "differs" in ran.stdout


@pytest.mark.long
@pytest.mark.skipif(not all(map(shutil.which, QEMU)), reason=f"needs {' and '.join(QEMU)}: install them from Debian")
def test_an_emulated_chip_gives_the_same_bits(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    (check,) = [check for check in manifest["checks"] if check["check"] == "C on an emulated cortex-m4f"]
    assert check["holds"]
    assert check["samples"] == 60
    assert check["instructions"] > 0


@pytest.mark.long
def test_the_folder_tells_the_gain_that_followed_from_the_design(tmp_path):
    assert call("export", "--controller", "pid, closed_loop_min=40", "--samples", "10", "--out", tmp_path / "pid") == 0
    used = tomllib.loads((tmp_path / "pid" / "run.toml").read_text())["used"]["controller"][0]
    numbers = (tmp_path / "pid" / "controller.csv").read_text()
    assert used["gain"] == 0.0  # it follows from the model
    assert f"proportional,,,{used['settled']['gain']!r}\n" in numbers
    manifest = json.loads((tmp_path / "pid" / "manifest.json").read_text())
    assert manifest["settled"] == used["settled"]


@pytest.mark.long
def test_what_was_not_run_is_not_claimed(folder):
    told = (folder / "PROOF.md").read_text()
    checks = json.loads((folder / "manifest.json").read_text())["checks"]
    assert all(check["holds"] in (True, None) for check in checks)
    held, not_run = told.split("## Not run")
    assert "Frama-C" in not_run
    assert "Frama-C" not in held
    assert "C on this computer" in held
    instructions, outcomes = (folder / "README.md").read_text(), {True: "held", None: "not run"}
    safety = (folder / "SAFETY.md").read_text()
    assert all(f"- {outcomes[check['holds']]}: {check['check']}" in instructions for check in checks)
    assert all(f"- For this folder, {outcomes[check['holds']]}: {check['check']}" in safety for check in checks)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--controller", "basal"), "an exported controller is a folder; name one with --out"),
        (("--target", "z80", "--out", "x"), "--target"),
        (("--precision", "float16", "--out", "x"), "--precision"),
        (("--samples", "2", "--out", "x"), "--samples"),
        (("--check", "nowhere"), "nowhere holds no run.toml"),
        (("--check", "nowhere", "--guard"), "leave out --guard"),
    ],
)
def test_mistakes_are_told_in_a_sentence(arguments, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("export", *arguments) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
