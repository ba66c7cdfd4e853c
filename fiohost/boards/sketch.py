"""The Uno's sources as one folder, which is what the Arduino IDE takes."""

from __future__ import annotations

import shutil
from pathlib import Path

from fiohost.errors import ConfigError

_PACKAGE = Path(__file__).parent
SKETCH = "fiohost_uno"
PARTS = {"core": ("*.c", "*.h"), "uno": ("*.c", "*.h", "*.ino")}


def write_sketch(folder: str | Path) -> Path:
    """Write the sketch into *folder* and return its own folder. Raises ConfigError where it cannot be written."""
    source = next((at for at in (_PACKAGE / "sources", _PACKAGE.parent.parent / "firmware") if at.is_dir()), None)
    if source is None:
        raise ConfigError("this installation of fiohost lacks the firmware's sources: install it anew")
    target = Path(folder) / SKETCH
    if target.exists():
        raise ConfigError(f"{target} is there already: give another folder, or take it away")
    try:
        target.mkdir(parents=True)
        for part, patterns in PARTS.items():
            for pattern in patterns:
                for path in sorted((source / part).glob(pattern)):
                    shutil.copyfile(path, target / path.name)
    except OSError as exc:
        raise ConfigError(f"cannot write {target}: {exc.strerror}") from exc
    return target
