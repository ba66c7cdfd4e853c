"""Estimation on arrays: records, predictions, simulation-error fits and intervals. Knows models, not boards, and
of logs only in ``logs``.

``fiohost.identify(...)`` is ``fiohost.identify.logs.identify``: the room has the name of its door, so it can be called.
"""

import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """K, tau, zeta and wn from logs: see ``fiohost.identify.logs.identify``."""
        from fiohost.identify.logs import identify

        return identify(*args, **kwargs)


sys.modules[__name__].__class__ = _Room
