"""Host tool for DC-motor control benches: drive, log, identify, and name what the model lacks.

The public names are loaded when first used, so that ``import fiohost`` costs nothing:
``connect``, ``Bench``, ``Log``, ``Model``, ``identify``, ``diagnose``,
``design``; for effects of one's own ``Effect``, ``Parameter``, ``register_effect``, ``check_effect``.
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"

_WHERE = {
    "connect": "fiohost.bench.connect",
    "Bench": "fiohost.bench.loop",
    "Log": "fiohost.bench.log",
    "Model": "fiohost.motor.model",
    "identify": "fiohost.estimation.logs",
    "diagnose": "fiohost.circle.evidence",
    "design": "fiohost.control.design",
    "Effect": "fiohost.motor.effect",
    "Parameter": "fiohost.motor.effect",
    "register_effect": "fiohost.motor.own",
    "check_effect": "fiohost.motor.check",
}

__all__ = ["__version__", *_WHERE]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'fiohost' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_WHERE[name]), name)
