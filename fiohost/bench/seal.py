"""Which seed a sealed bench was drawn with: kept in the user's state directory under the random run id of its logs.

The log itself carries neither seed nor plant nor anything made from them, so only this store can open it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from pathlib import Path

from fiohost.bench.log import Log
from fiohost.errors import ConfigError, FiohostError
from fiohost.files import shown
from fiohost.settings import exists

MAX_SEED = 2**63 - 1
SEALED = ("sim:sealed", "sim:sealed-faulty")
STUDENT = "sim:student:"  # and who: a sealed board of one's own
_STUDENT_ID = re.compile(r"[\w.@-]{1,80}")


def is_sealed(target: str) -> bool:
    """Whether nobody is told what is behind a target: a simulated board, or an emulated one with such a plant."""
    of_emulation = target.startswith("emulated:") and target.endswith(":sealed")
    return target in SEALED or target.startswith(STUDENT) or of_emulation


def is_faulty(target: str) -> bool:
    """Whether a sealed target also has faults of line and clock."""
    return target == SEALED[1]


def state_dir() -> Path:
    """Where fiohost keeps what outlives a command: ``$XDG_STATE_HOME/fiohost``, ``~/.local/state/fiohost``."""
    base = os.environ.get("XDG_STATE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(base) if base else Path.home() / ".local" / "state") / "fiohost"


def student_seed(student: str) -> int:
    """The seed of a student's board: always the same for the same name. Raises ConfigError for what is no name."""
    if not _STUDENT_ID.fullmatch(student):
        raise ConfigError(f"{shown(student)!r} is no student's name or number: letters, digits and . _ @ - make one")
    return int.from_bytes(hashlib.sha256(f"fiohost student {student.lower()}".encode()).digest()[:4], "big")


def draw_seed() -> int:
    """A seed from the system's randomness."""
    return secrets.randbelow(2**32)


def store_seed(run_id: str, seed: int) -> None:
    """Keep the seed of a run. Raises ConfigError where the state directory cannot be written."""
    path = _seal_path(run_id)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"run_id": run_id, "seed": seed}) + "\n")
    except OSError as exc:
        raise ConfigError(
            f"cannot keep the seal in {path.parent}: {exc.strerror}; set XDG_STATE_HOME to a folder that can be written"
        ) from exc


def find_seed(seed_or_log: str) -> int:
    """The seed meant by a number or by a log of a sealed bench. Raises ConfigError, LogError."""
    if re.fullmatch(r"\d+", seed_or_log):
        if int(seed_or_log) > MAX_SEED:
            raise ConfigError(f"seed {seed_or_log[:30]} is larger than {MAX_SEED}")
        return int(seed_or_log)
    if not exists(Path(seed_or_log)):
        raise ConfigError(f"{shown(seed_or_log)!r} is neither a seed (a whole number) nor a log file")
    log = Log.read(seed_or_log)
    if not is_sealed(log.metadata.get("target", "")):
        raise ConfigError(f"{seed_or_log} is a log of {log.metadata.get('target', 'an unnamed target')!r}: not sealed")
    run_id = log.metadata.get("run_id", "")
    path = _seal_path(run_id) if re.fullmatch(r"[0-9a-f]{8,64}", run_id) else None
    if path is None or not path.is_file():
        raise ConfigError(f"the seal of {seed_or_log} is not kept here ({state_dir()}): another user or machine ran it")
    try:
        return int(json.loads(path.read_text())["seed"])
    except (OSError, ValueError, KeyError, TypeError) as exc:
        raise FiohostError(f"the seal {path} is damaged: {exc}") from exc


def find_version(seed_or_log: str) -> int | None:
    """The version of the draws that a log says; None for a seed, which is then one of the newest. Logs that say none
    are of the first version. Raises ConfigError, LogError.
    """
    if re.fullmatch(r"\d+", seed_or_log):
        return None
    said = Log.read(seed_or_log).metadata.get("sealed_version", "1")
    if not re.fullmatch(r"\d{1,6}", said):
        raise ConfigError(f"{seed_or_log} says sealed_version = {said[:40]!r}, which is no version")
    return int(said)


def _seal_path(run_id: str) -> Path:
    return state_dir() / "seals" / f"{run_id}.json"
