"""Debian's kernel in an emulated computer that is a USB board and its own host: the test of the real lines.

    python tests/guest/boot.py                                          the test
    python tests/guest/boot.py --run "fiohost doctor --target hid" --board "--device /dev/hidg0"
    python tests/guest/boot.py --run "python benchmarks/line.py --hid --node /dev/hidg0"

It needs qemu-system-x86; a kernel is fetched, not installed. The guest sees this computer's files, this checkout and
this Python among them; what it writes stays in its memory, but for the folder /run/out, which --keep leaves here.

Its clock counts instructions, one a nanosecond, and leaps over idle time. So its times do not depend on what else this
computer does: they are those of a computer that is somewhat slower than today's and has nothing else to do.
``--real-time`` gives it two processors and this computer's clock instead.

Exit code of the test or of the command; 0 with a banner where no guest can be had.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from image import MODULES, NoGuestError, fetch, first_files, in_order

ROOT = Path(__file__).resolve().parents[2]
INSIDE = Path(__file__).resolve().with_name("inside.py")
QEMU = "qemu-system-x86_64"
LIMIT_S = 3000.0  # for hangs only: alone it takes a tenth of this
COUNTED = ("-accel", "tcg,thread=single", "-icount", "shift=0,sleep=off", "-smp", "1")
REAL_TIME = ("-accel", "tcg,thread=multi", "-smp", "2")
# numba's machine code is made here and used there: for any x86-64, so that it fits both
COMPILED_FOR = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}
PLAIN = {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HOME": "/root", "TERM": "dumb"}
PATH = "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"


def main() -> int:
    asked = _parser().parse_args()
    work = Path(tempfile.mkdtemp(prefix="fiohost-guest-"))
    code = 1
    try:
        qemu = shutil.which(QEMU)
        if qemu is None:
            raise NoGuestError(f"there is no {QEMU}: apt-get install qemu-system-x86")
        parts = fetch(Path(asked.cache))
        (work / "initrd").write_bytes(first_files(parts.programs, in_order(parts.modules, MODULES)))
        code = _guest(qemu, parts.kernel, work, asked)
    except (NoGuestError, OSError) as exc:
        bar = "!" * 100
        print(
            f"{bar}\n!!! NO GUEST: {exc}\n!!! THE REAL LINES (hidraw, libusb, ttyACM) ARE NOT TESTED\n{bar}", flush=True
        )
        code = 0
    finally:
        if code or asked.keep:
            print(f"the guest's files are kept in {work}", file=sys.stderr)
        else:
            shutil.rmtree(work, ignore_errors=True)
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="WORDS", help="of the test: steps with these words in line or name")
    parser.add_argument("--run", metavar="COMMAND", help="in place of the test: run this in the guest, in the checkout")
    parser.add_argument(
        "--board", metavar="OPTIONS", help="with --run: serve a board (python -m firmware_model OPTIONS)"
    )
    parser.add_argument("--real-time", action="store_true", help="two processors, this computer's clock")
    parser.add_argument("--limit", type=float, default=LIMIT_S, metavar="S", help=f"give up after S s ({LIMIT_S:g})")
    parser.add_argument("--keep", action="store_true", help="keep its console and /run/out, also where all went well")
    cache = Path(tempfile.gettempdir()) / f"fiohost-guest-packages-{os.getuid()}"
    parser.add_argument("--cache", default=str(cache), metavar="DIR", help=f"where packages are kept ({cache})")
    return parser


def _guest(qemu: str, kernel: Path, work: Path, asked: argparse.Namespace) -> int:
    """Boot it, show what it says, and give the exit code of what ran there. Raises NoGuestError."""
    out = work / "out"
    out.mkdir()
    environment = {
        **PLAIN,
        **COMPILED_FOR,
        "NUMBA_CACHE_DIR": str(work / "compiled"),
        "MPLCONFIGDIR": str(work / "fonts"),
    }
    _fill_caches(environment)
    (out / "command").write_text(_script(environment, asked))
    command = [qemu, *(REAL_TIME if asked.real_time else COUNTED), "-cpu", "Nehalem", "-m", "2G", "-nodefaults"]
    command += ["-no-reboot", "-display", "none", "-kernel", str(kernel), "-initrd", str(work / "initrd")]
    # Debian's kernel has scripts as a module: it cannot begin with one
    command += ["-append", "console=ttyS0 panic=-1 mitigations=off tsc=reliable rdinit=/bin/busybox -- sh /init.sh"]
    command += ["-serial", f"file:{work / 'console'}", "-serial", "stdio"]
    command += ["-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"]
    command += ["-virtfs", f"local,path={out},mount_tag=out,security_model=none"]
    began_s = time.monotonic()
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    late = threading.Timer(asked.limit, process.kill)
    late.start()
    said = ""
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said = line.rstrip()
            print(said, flush=True)
        process.wait()
    finally:
        late.cancel()
        process.kill()
        process.wait()
    took_s = time.monotonic() - began_s
    if process.returncode > 0:  # it ends with 0 when the guest does
        raise NoGuestError(f"{QEMU} ends with {process.returncode}: {said}")
    code = (out / "code").read_text().strip() if (out / "code").exists() else ""
    if not code:
        console = (work / "console").read_text(errors="replace").splitlines()
        print("\n".join(console[-30:]), file=sys.stderr)
        reason = f"was stopped after {took_s:.0f} s" if process.returncode < 0 else "ended without a word"
        print(f"the guest {reason}; above is the end of its console", file=sys.stderr)
        return 1
    print(f"guest: {took_s:.0f} s in all, exit code {code}", flush=True)
    return int(code)


def _script(environment: dict[str, str], asked: argparse.Namespace) -> str:
    """What the guest's shell runs."""
    path = f"{Path(sys.executable).parent}:{PATH}"
    lines = [f"export {name}={shlex.quote(value)}" for name, value in {**environment, "PATH": path}.items()]
    options = {"--only": asked.only, "--run": asked.run, "--board": asked.board}
    arguments = [word for name, value in options.items() if value is not None for word in (name, value)]
    lines += [f"cd {shlex.quote(str(ROOT))}", shlex.join([sys.executable, str(INSIDE), *arguments])]
    return "\n".join(lines) + "\n"


def _fill_caches(environment: dict[str, str]) -> None:
    """Those of numba and matplotlib; an emulated computer would take minutes for it."""
    code = "import matplotlib.font_manager; from firmware_model import Board, load_plant; "
    code += "Board(load_plant('default')).step(None)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env={**os.environ, **environment}, check=True)


if __name__ == "__main__":
    sys.exit(main())
