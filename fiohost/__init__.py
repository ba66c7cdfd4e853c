"""Host tool for DC-motor control benches: drive, log, identify, and name what the model lacks.

The public names are loaded when first used, so that ``import fiohost`` costs nothing::

    connect        a bench: with fiohost.connect("sim") as b: b.duty = 40; b.sleep(1); b.angle_deg
    read_log       a log, or any table: CSV, .mat, HDF5, Parquet, a pandas DataFrame
    identify       gain and lag of a motor from logs
    diagnose       what a model lacks: .summary(), .plot(), .report(path), .to_json(), .to_dataframe()
    simulate       a model on the commands of a log, or on an array of duties
    design         gains of a controller that meet a specification
    plot           logs as a picture
    Effect         with Parameter, register_effect and check_effect: an effect of one's own
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fiohost.api import Diagnosis, Simulation, diagnose, identify, plot, read_log, read_logs, simulate, to_dataframe
    from fiohost.bench.connect import connect
    from fiohost.bench.log import Log
    from fiohost.bench.loop import Bench
    from fiohost.control.design import Design, design
    from fiohost.control.settings import ControlSettings
    from fiohost.errors import FiohostError
    from fiohost.estimation.logs import Identification
    from fiohost.export.python_control import to_control
    from fiohost.motor.check import check_effect
    from fiohost.motor.effect import Effect, Parameter
    from fiohost.motor.model import Model
    from fiohost.motor.own import register_effect

_WHERE = {
    "Bench": "fiohost.bench.loop",
    "ControlSettings": "fiohost.control.settings",
    "Design": "fiohost.control.design",
    "Diagnosis": "fiohost.api",
    "Effect": "fiohost.motor.effect",
    "FiohostError": "fiohost.errors",
    "Identification": "fiohost.estimation.logs",
    "Log": "fiohost.bench.log",
    "Model": "fiohost.motor.model",
    "Parameter": "fiohost.motor.effect",
    "Simulation": "fiohost.api",
    "check_effect": "fiohost.motor.check",
    "connect": "fiohost.bench.connect",
    "design": "fiohost.control.design",
    "diagnose": "fiohost.api",
    "identify": "fiohost.api",
    "plot": "fiohost.api",
    "read_log": "fiohost.api",
    "read_logs": "fiohost.api",
    "register_effect": "fiohost.motor.own",
    "simulate": "fiohost.api",
    "to_control": "fiohost.export.python_control",
    "to_dataframe": "fiohost.api",
}

__all__ = [
    "Bench", "ControlSettings", "Design", "Diagnosis", "Effect", "FiohostError", "Identification", "Log", "Model",
    "Parameter", "Simulation", "__version__", "check_effect", "connect", "design", "diagnose", "identify", "plot",
    "read_log", "read_logs", "register_effect", "simulate", "to_control", "to_dataframe",
]  # fmt: skip


def __dir__() -> list[str]:
    return sorted(__all__)


if not TYPE_CHECKING:  # else a misspelled name would pass as Any

    def __getattr__(name: str) -> Any:
        if name not in _WHERE:
            import difflib

            close = difflib.get_close_matches(name, _WHERE, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise AttributeError(f"module 'fiohost' has no attribute {name!r}{hint}")
        import importlib

        value = getattr(importlib.import_module(_WHERE[name]), name)
        globals()[name] = value
        return value
