"""What stands in a folder in the place of a file: it is named, and neither followed, waited for nor written through."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import socket
import stat

import pytest

from glucoloop.storage.disk import SUMS, put_file, read_sums, sums_text
from glucoloop.storage.folder import output_folder
from glucoloop.trials.folder import TrialOrigin, done_shards, trial_folder

pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="links, pipes and devices"),
    pytest.mark.usefixtures("_quick_disk"),
]
PATIENCE_S = 20


@contextlib.contextmanager
def within_patience():
    """A hang is a failure."""

    def hang(number, frame):
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _socket(place, foreign):
    with contextlib.chdir(place.parent), socket.socket(socket.AF_UNIX) as made:  # of a path that may be long
        made.bind(place.name)


def _device(place, foreign):
    try:
        os.mknod(place, stat.S_IFCHR | 0o666, os.makedev(1, 5))  # zeros without end
    except PermissionError:
        pytest.skip("only root makes devices")


SUBSTITUTES = {
    "link to a file": lambda place, foreign: place.symlink_to(foreign / "file"),
    "link to nothing": lambda place, foreign: place.symlink_to(foreign / "absent"),
    "link to a folder": lambda place, foreign: place.symlink_to(foreign),
    "link to a device": lambda place, foreign: place.symlink_to("/dev/zero"),
    "link to itself": lambda place, foreign: place.symlink_to(place.name),
    "hard link": lambda place, foreign: os.link(foreign / "file", place),
    "pipe": lambda place, foreign: os.mkfifo(place),
    "socket": _socket,
    "device": _device,
    "folder": lambda place, foreign: place.mkdir(),
    "file": lambda place, foreign: place.write_bytes(b"something else"),
}
PLACES = (
    "lock",
    "trial.json",
    ".trial.json.part",
    "trial.toml",
    ".trial.toml.part",
    SUMS,
    f".{SUMS}.part",
    "summary.json",
    ".report.html.part",
    "shards",
    ".shards.part",
    "shards/00000",
    "shards/.00001.part",
    "shards/00000/people.parquet",
    "shards/00000/shard.json",
    f"shards/00000/{SUMS}",
)


def snapshot(folder):
    return {
        str(entry): (entry.lstat().st_mode, entry.read_bytes() if entry.is_file() else b"")
        for entry in sorted(folder.rglob("*"))
    }


@pytest.fixture
def foreign(tmp_path):
    """What belongs to somebody else."""
    place = tmp_path / "foreign"
    place.mkdir()
    (place / "file").write_text("mine")
    return place


def put(place, name, foreign):
    if place.is_dir() and not place.is_symlink():
        shutil.rmtree(place)
    place.unlink(missing_ok=True)
    SUBSTITUTES[name](place, foreign)


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_substitute_is_neither_followed_nor_waited_for(tmp_path, tiny, foreign, place):
    tiny, other = tiny
    tiny.run(tmp_path / "whole")
    before = snapshot(foreign)
    for number, name in enumerate(SUBSTITUTES):
        for finished, of in ((False, tiny), (True, tiny), (True, other)):
            out = tmp_path / f"out{number}{finished}{of is tiny}"
            shutil.copytree(tmp_path / "whole", out)
            if not finished:
                shutil.rmtree(out / "shards/00001")
                (out / SUMS).unlink()
            put(out / place, name, foreign)
            with within_patience(), contextlib.suppress(ValueError):
                of.run(out, overwrite=of is other)
                # What was not refused is right.
                for file, value in read_sums(out).items():
                    assert hashlib.sha256((out / file).read_bytes()).hexdigest() == value
                    assert not (out / file).is_symlink()
            with within_patience(), contextlib.suppress(ValueError):
                done_shards(out, TrialOrigin.of_folder(out))
            assert snapshot(foreign) == before, (name, finished, of is tiny)


@pytest.mark.parametrize("name", SUBSTITUTES)
def test_substitute_in_a_folder_of_rows(tmp_path, counting, foreign, name):
    whole, other = counting(), counting(keys={"seed": 2})
    whole.run(tmp_path / "whole")
    before = snapshot(foreign)
    for place in (
        "lock",
        "count.toml",
        "origin.json",
        "numbers.parquet",
        ".numbers.parquet.part",
        SUMS,
        "count.json",
    ):
        for finished, of in ((False, whole), (True, whole), (True, other)):
            out = tmp_path / f"{place}{finished}{of is whole}"
            shutil.copytree(tmp_path / "whole", out)
            if not finished:
                (out / SUMS).unlink()
            put(out / place, name, foreign)
            with within_patience(), contextlib.suppress(ValueError):
                of.run(out, overwrite=of is other)
                for file, value in read_sums(out).items():
                    assert hashlib.sha256((out / file).read_bytes()).hexdigest() == value
                    assert not (out / file).is_symlink()
            assert snapshot(foreign) == before, (place, finished, of is whole)


@pytest.mark.parametrize("name", SUBSTITUTES)
@pytest.mark.parametrize("place", [SUMS, "a.txt", ""])
def test_substitute_in_an_output_folder(tmp_path, foreign, place, name):
    with output_folder(tmp_path / "out", overwrite=False) as made:
        made.write("a.txt", "one")
    put(tmp_path / "out" / place if place else tmp_path / "out", name, foreign)
    before = snapshot(foreign)
    with within_patience(), contextlib.suppress(ValueError):
        with output_folder(tmp_path / "out", overwrite=True) as made:
            made.write("b.txt", "two")
        assert (tmp_path / "out/b.txt").read_text() == "two"
    if name == "link to nothing" and not place:  # the user named it, so it is followed
        shutil.rmtree(foreign / "absent")
    assert snapshot(foreign) == before


def reseal(path, *, shard=None):
    """Make the lists of digests fit what is there, as somebody would who wants to deceive."""
    if shard is not None:
        names = [file.name for file in shard.iterdir() if file.name != SUMS]
        digests = {name: hashlib.sha256((shard / name).read_bytes()).hexdigest() for name in names}
        (shard / SUMS).write_bytes(sums_text(digests))
    files = [file for file in path.rglob("*") if file.is_file() and file.parent.name != "shards" and file.name != SUMS]
    files += [file for file in path.glob("shards/*/*") if file.name != SUMS]
    sums = {str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    put_file(path / SUMS, sums_text(sums))


def _swap(out, tmp_path):
    (out / "shards/00000").rename(out / "a")
    (out / "shards/00001").rename(out / "shards/00000")
    (out / "a").rename(out / "shards/00001")


def _duplicate(out, tmp_path):
    shutil.rmtree(out / "shards/00001")
    shutil.copytree(out / "shards/00000", out / "shards/00001")


def _foreign_shard(out, tmp_path):
    shutil.rmtree(out / "shards/00001")
    shutil.copytree(tmp_path / "other/shards/00001", out / "shards/00001")


def _extra(out, tmp_path):
    shutil.copytree(out / "shards/00000", out / "shards/00002")


def _extra_name(out, tmp_path):
    shutil.copytree(out / "shards/00000", out / "shards/000001")


def _empty(out, tmp_path):
    shutil.rmtree(out / "shards/00001")
    (out / "shards/00001").mkdir()


def _no_digests(out, tmp_path):
    (out / "shards/00001" / SUMS).unlink()


def _fewer_digests(out, tmp_path):
    place = out / "shards/00001" / SUMS
    place.write_text("".join(place.read_text().splitlines(keepends=True)[1:]))


def _extra_file(out, tmp_path):
    shutil.copy(out / "shards/00001/people.parquet", out / "shards/00001/traces.parquet")


def _relabelled(out, tmp_path):
    place = out / "shards/00001"
    told = json.loads((place / "shard.json").read_text())
    (place / "shard.json").write_text(json.dumps({**told, "index": 0}))
    reseal(out, shard=place)


def _people_of_another(out, tmp_path):
    shutil.copy(out / "shards/00000/people.parquet", out / "shards/00001/people.parquet")


def _header(out, tmp_path):
    told = json.loads((out / "trial.json").read_text())
    (out / "trial.json").write_text(json.dumps({**told, "people": 3}))


ATTACKS = [
    _swap,
    _duplicate,
    _foreign_shard,
    _extra,
    _extra_name,
    _empty,
    _no_digests,
    _fewer_digests,
    _extra_file,
    _relabelled,
    _people_of_another,
    _header,
]


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("finished", [False, True, "resealed"])
def test_shards_stand_for_no_other(tmp_path, tiny, attack, finished):
    tiny, other = tiny
    out = tmp_path / "out"
    tiny.run(out)
    other.run(tmp_path / "other")
    attack(out, tmp_path)
    if finished is True:
        pass
    elif finished == "resealed":
        reseal(out)
    else:
        (out / SUMS).unlink(missing_ok=True)
    before = snapshot(out)
    with pytest.raises(ValueError, match=r"damaged|belongs to something else|is no part|was changed|does not list"):
        tiny.run(out)
    assert snapshot(out) == before
    if attack is not _header:
        with pytest.raises(ValueError, match=r"damaged|belongs to something else|is no part"):
            done_shards(out, TrialOrigin.of_folder(out))


def test_list_of_digests_is_complete(tmp_path, tiny):
    tiny, _ = tiny
    tiny.run(tmp_path / "out")
    lines = (tmp_path / "out" / SUMS).read_text().splitlines(keepends=True)
    for number, line in enumerate(lines):
        for changed in (lines[:number] + lines[number + 1 :], [*lines, line], [line.replace("  ", " ")], ["\0"]):
            (tmp_path / "out" / SUMS).write_text("".join(changed))
            with pytest.raises(ValueError, match=r"SHA256SUMS (was changed|does not list)"):
                tiny.run(tmp_path / "out")
    (tmp_path / "out" / SUMS).write_text("".join(lines))
    tiny.run(tmp_path / "out")


def test_people_under_another_name_are_noticed_when_they_are_read(tmp_path, tiny):
    """Digests that somebody made to fit do not make other people of them."""
    tiny, _ = tiny
    out = tmp_path / "out"
    tiny.run(out)
    shutil.copy(out / "shards/00000/people.parquet", out / "shards/00001/people.parquet")
    reseal(out, shard=out / "shards/00001")
    with trial_folder(out, tiny.trial) as folder, pytest.raises(ValueError, match=r"damaged: the rows of 'basal' are"):
        list(folder.people())
