"""Where things are, for tests: the checkout, and the packages that the tests import."""

from __future__ import annotations

from pathlib import Path

import fiohost

ROOT = Path(__file__).resolve().parent.parent
# Programs that tests start run what the tests import: installed or not, its kernels are compiled but once.
PACKAGES = Path(fiohost.__file__).resolve().parent.parent
