"""The programs that ours is measured against, from PyPI, in an environment of their own.

A benchmark that calls ``among`` goes on in that environment: it is made at the first call (a minute or two) and kept in
``~/.cache/fiohost-peers``, or in the folder that ``FIOHOST_PEERS`` names. Our own package is that of this checkout.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
import venv
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PEERS = ("casadi>=3.6", "control>=0.10", "gym-electric-motor>=2.0", "lmfit>=1.3", "mujoco[sysid]>=3.5", "pysindy>=2.0",
         "sysidentpy>=0.5")  # fmt: skip
INSIDE = "FIOHOST_AMONG_PEERS"


def among() -> None:
    """Run the calling script in the peers' environment and leave with its exit code; there already, return."""
    if os.environ.get(INSIDE):
        return
    done = subprocess.run([str(environment()), *sys.argv], env={**os.environ, INSIDE: "1"})
    sys.exit(done.returncode)


def environment() -> Path:
    """The interpreter of the peers' environment, which is made where it is not there or was not finished."""
    home = Path(os.environ.get("FIOHOST_PEERS") or Path.home() / ".cache" / "fiohost-peers")
    name = hashlib.sha256(repr((PEERS, str(ROOT), sys.version_info[:2])).encode()).hexdigest()[:12]
    folder = home / name
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    whole = folder / "whole"
    if not whole.exists():
        print(f"installing {', '.join(PEERS)} into {folder} ...", file=sys.stderr, flush=True)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([str(python), "-m", "pip", "install", "-q", "-e", str(ROOT), *PEERS], check=True)
        whole.touch()
    return python


def versions(*names: str) -> str:
    """Names of packages with their versions."""
    return ", ".join(f"{name} {version(name)}" for name in names)


def seconds(run: Callable[[], object], least_s: float = 0.3, most: int = 20, long_s: float = 5.0) -> float:
    """The least processor time of a few runs, in s: of all threads. The first one only warms up, unless it is long."""
    spans: list[float] = []
    while len(spans) < most and (len(spans) < 2 or sum(spans[1:]) < least_s):
        began = time.process_time()
        run()
        spans.append(time.process_time() - began)
        if spans[0] > long_s:
            return spans[0]
    return min(spans[1:])
