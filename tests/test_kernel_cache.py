"""Kernels kept on disk are code: nobody but this user may put them where they are loaded from."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from places import ROOT

from fiohost.motor import compiled as host_side
from firmware_model import compiled as board_side

NOBODY = 65534
needs_two_users = pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can make folders of another user"
)


def kept() -> list[str]:
    """Where both packages keep their kernels now; empty where nowhere."""
    host_side.cache_dir.cache_clear()
    board_side.kept_in.cache_clear()
    try:
        return [str(host_side.cache_dir() or ""), board_side.kept_in()]
    finally:
        host_side.cache_dir.cache_clear()
        board_side.kept_in.cache_clear()


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_new_cache_is_closed_to_others(root: Path) -> None:
    for folder in kept():
        path = Path(folder)
        while path != root:
            assert stat.S_IMODE(path.stat().st_mode) == 0o700, path
            path = path.parent


@pytest.mark.parametrize("package", ["fiohost", "firmware_model"])
def test_a_link_and_a_folder_that_others_can_write_are_not_used(package: str, root: Path) -> None:
    mine = kept()
    which = ["fiohost", "firmware_model"].index(package)
    folder = Path(mine[which])
    (folder / "kernel.nbc").write_bytes(b"")
    folder.chmod(0o777)
    assert kept()[which] == ""
    folder.chmod(0o755)  # others could look, and no more: it is closed and used
    assert kept()[which] == mine[which]
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.rename(folder.parent / "elsewhere")
    folder.symlink_to(folder.parent / "elsewhere")
    assert kept()[which] == ""


def test_where_the_cache_cannot_be_written_kernels_stay_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not in a folder of the temporary ones, which anybody can make first."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert kept() == ["", ""]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@needs_two_users
def test_a_folder_that_another_user_made_first_is_not_used(root: Path) -> None:
    for folder in kept():
        os.chown(folder, NOBODY, NOBODY)
    assert kept() == ["", ""]


@needs_two_users
def test_a_root_that_another_user_owns_is_not_used(root: Path) -> None:
    root.mkdir()
    os.chown(root, NOBODY, NOBODY)
    assert kept() == ["", ""]


def test_a_planted_kernel_is_not_run(tmp_path: Path) -> None:
    """The whole way: somebody makes the folder first, open to himself, and waits."""
    code = (
        "import os, tempfile, pathlib\nfrom fiohost.motor.compiled import cache_dir\n"
        "from firmware_model.compiled import kept_in\nprint(cache_dir(), kept_in())"
    )
    (tmp_path / "no-home").write_text("")
    for name in (f"cache-{os.getuid()}", "cache-of-root"):
        (tmp_path / name).mkdir(mode=0o777)
    environment = {
        **{k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "HOME")},
        "HOME": str(tmp_path / "no-home"),
        "TMPDIR": str(tmp_path),
        "PYTHONPATH": str(ROOT),
    }
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["None"]


KERNELS = """
from numba import types
from fiohost.motor.compiled import compiled, inlined, part, shared

@part
def thrice(x):
    return 3.0 * x

@inlined
def sixfold(x):
    return 2.0 * thrice(x)

@shared(types.none(types.float64[::1], types.int64))
def raise_all(values, count):
    for i in range(count):
        values[i] = sixfold(values[i])

@compiled
def raise_twice(values, count):
    raise_all(values, count)
    raise_all(values, count)
"""
USE = """
import numpy as np, kernels
values = np.ones(3)
kernels.raise_twice(values, 3)
(made,) = kernels.raise_twice.overloads.values()
names = [f.name for f in made.library.get_defined_functions()]
print(values[0], sum(kernels.raise_twice.stats.cache_hits.values()), any("sixfold" in n for n in names))
kernels.raise_all(values, 3)
print(values[2])
"""


def test_a_kernel_that_others_call_is_compiled_once_and_found_when_they_are_loaded(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(KERNELS)
    places = os.pathsep.join((str(tmp_path), str(ROOT)))
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": places}

    def used() -> list[str]:
        said = subprocess.run([sys.executable, "-c", USE], env=environment, capture_output=True, text=True, check=True)
        return said.stdout.split()

    assert used() == ["36.0", "0", "False", "216.0"]  # compiled: the caller holds no copy of what it calls
    assert used() == ["36.0", "1", "False", "216.0"]  # loaded from the cache, and so is what it calls
    for kept in (tmp_path / "cache").rglob("kernels.raise_all*"):
        kept.unlink()
    assert used() == ["36.0", "1", "False", "216.0"]  # loaded, with what it calls compiled anew
