"""What a guest boots from: Debian's kernel, its modules in the order in which they load, and a first file system.

Everything comes from Debian's packages, fetched and unpacked into a folder without being installed. The first file
system has one static program (busybox), the modules, udev and ``init.sh``; the rest the guest sees through 9p.
"""

from __future__ import annotations

import gzip
import lzma
import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
KERNEL = "linux-image-amd64"  # names the newest kernel; the cloud one has no USB gadgets
BUSYBOX = "busybox-static"
UDEV = ("udev", "libkmod2")  # libusb learns from it that a board came back
MODULES = (
    *("binfmt_script", "virtio_pci", "9pnet_virtio", "9p", "overlay"),
    *("dummy_hcd", "libcomposite", "usb_f_hid", "usb_f_acm", "usbhid", "hid-generic", "cdc-acm", "uhid", "usbmon"),
)


class NoGuestError(Exception):
    """This machine cannot boot a guest; the text says why."""


@dataclass(frozen=True)
class Parts:
    """Files from the packages. ``programs`` go into the folder bin of the first file system."""

    kernel: Path
    modules: Path  # their folder
    programs: tuple[Path, ...]


def fetch(folder: Path) -> Parts:
    """The packages, unpacked below *folder*, which keeps them. Raises NoGuestError."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise NoGuestError(f"{folder} belongs to somebody else: choose another with --cache")
    package = re.search(r"Depends: (linux-image-[^\s(,]+)", _run(folder, "apt-cache", "depends", KERNEL))
    if package is None:
        raise NoGuestError(f"the package {KERNEL} names no kernel")
    for name in (package[1], BUSYBOX, *UDEV):
        if not (folder / name / "unpacked").exists():
            _run(folder, "apt-get", "download", "-q", name)
            deb = next(folder.glob(f"{name}_*.deb"))
            _run(folder, "dpkg-deb", "-x", str(deb), name)
            deb.unlink()
            (folder / name / "unpacked").touch()
    for old in set(folder.glob("linux-image-*")) - {folder / package[1]}:  # 400 MB each
        shutil.rmtree(old, ignore_errors=True)
    return Parts(
        _one(folder / package[1], "vmlinuz-*"),
        _one(folder / package[1], "lib/modules/*"),
        (
            _one(folder / BUSYBOX, "bin/busybox"),
            _one(folder / "udev", "bin/udevadm"),
            _one(folder / "libkmod2", "libkmod.so.2"),
        ),
    )


def _one(folder: Path, pattern: str) -> Path:
    """The one file of a package. Raises NoGuestError."""
    found = sorted(folder.rglob(pattern))
    if not found:
        raise NoGuestError(f"the package in {folder.name} is not packed as it was: no {pattern} in it")
    return found[0]


def _run(folder: Path, *command: str) -> str:
    try:
        return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, timeout=300).stdout
    except FileNotFoundError as exc:
        raise NoGuestError(f"there is no {command[0]}: this is no Debian") from exc
    except subprocess.TimeoutExpired as exc:
        raise NoGuestError(f"'{' '.join(command)}' takes longer than 300 s") from exc
    except subprocess.CalledProcessError as exc:
        said = exc.stderr.strip().splitlines()
        raise NoGuestError(f"'{' '.join(command)}' failed: {said[-1] if said else 'it does not say why'}") from exc


def in_order(folder: Path, names: Iterable[str]) -> list[tuple[str, bytes]]:
    """Modules and all that they need, each after what it needs: names and contents. Raises NoGuestError."""
    files = {path.name.partition(".ko")[0].replace("-", "_"): path for path in folder.rglob("*.ko*")}
    built_in = _built_in(folder)
    found: dict[str, bytes] = {}

    def add(name: str) -> None:
        name = name.replace("-", "_")
        if name in found or name in built_in:
            return
        if name not in files:
            raise NoGuestError(f"Debian's kernel {folder.name} has no module {name}")
        data = files[name].read_bytes()
        data = lzma.decompress(data) if files[name].suffix == ".xz" else data
        needs = re.search(rb"\0depends=([^\0]*)\0", data)
        for needed in (needs[1].decode() if needs else "").split(","):
            if needed:
                add(needed)
        found[name] = data

    for name in names:
        add(name)
    return list(found.items())


def _built_in(folder: Path) -> set[str]:
    listed = folder / "modules.builtin"
    lines = listed.read_text().splitlines() if listed.exists() else []
    return {Path(line).name.partition(".ko")[0].replace("-", "_") for line in lines}


def first_files(programs: Iterable[Path], modules: list[tuple[str, bytes]]) -> bytes:
    """The first file system (initramfs): a cpio archive of the form "newc"."""
    order = "".join(f"{name}\n" for name, _ in modules).encode()
    files: dict[str, tuple[int, bytes]] = {name: (0o040755, b"") for name in ("bin", "modules", "proc", "sys", "dev")}
    files |= {name: (0o040755, b"") for name in ("host", "changes", "out", "root")}
    files |= {f"bin/{path.name}": (0o100755, path.read_bytes()) for path in programs}
    files["init.sh"] = (0o100644, (HERE / "init.sh").read_bytes())
    files["modules/order"] = (0o100644, order)
    files |= {f"modules/{name}.ko": (0o100644, data) for name, data in modules}
    archive = b"".join(_entry(number, *item) for number, item in enumerate(files.items(), 1))
    return gzip.compress(archive + _entry(0, "TRAILER!!!", (0, b"")), compresslevel=1)


def _entry(number: int, name: str, content: tuple[int, bytes]) -> bytes:
    mode, data = content
    links = 2 if mode & 0o040000 else 1
    fields = (number, mode, 0, 0, links, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields) + os.fsencode(name) + b"\0"
    return head + b"\0" * (-len(head) % 4) + data + b"\0" * (-len(data) % 4)
