"""One bench's work, as it is done by any process anywhere: bytes of logs go in, plain numbers come out."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiohost.importing.found import Answers

SCHEMA = "fiohost.fleet_bench/4"
ALL, NONE = "all", "none"


@dataclass(frozen=True)
class Settings:
    """What is done with each bench: the declared model (a file's text or an expression), whether what it lacks is
    looked for, the seed, and what is said of tables: a map (its text) or answers.
    """

    model: str
    model_file: str | None = None
    diagnose: bool = True
    seed: int = 0
    map_file: str | None = None
    answers: Answers | None = None

    @property
    def text(self) -> str:
        return repr(self)


def work(name: str, contents: Mapping[str, bytes], logs: int, settings: Settings) -> dict[str, Any]:
    """Fit and diagnose one bench; what cannot be done is said in ``error``."""
    from fiohost.errors import FiohostError

    began, cpu = time.monotonic(), time.process_time()
    row: dict[str, Any] = {"schema": SCHEMA, "bench": name, "error": None}
    try:
        with tempfile.TemporaryDirectory(prefix="fiohost-") as folder:
            row |= _done(Path(folder), contents, logs, settings)
    except FiohostError as exc:
        row["error"] = str(exc)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as exc:  # one bench's numbers are not all benches'
        row["error"] = f"{type(exc).__name__}: {exc}"
    return row | {"seconds": time.monotonic() - began, "cpu_s": time.process_time() - cpu}


def _done(folder: Path, contents: Mapping[str, bytes], logs: int, settings: Settings) -> dict[str, Any]:
    from threadpoolctl import threadpool_limits

    from fiohost.circle.evidence import diagnose, read_logs
    from fiohost.discover.result import to_json
    from fiohost.estimation.record import record_from_log
    from fiohost.motor.model import Model

    paths = []
    for name, data in contents.items():
        paths.append(folder / name)
        paths[-1].write_bytes(data)
    if settings.model_file is not None:
        (folder / "model.toml").write_text(settings.model_file)
    model = Model.parse(str(folder / "model.toml") if settings.model_file is not None else settings.model)
    if settings.map_file is not None:
        (folder / "map.toml").write_text(settings.map_file)
    read = read_logs(paths, settings.answers if settings.map_file is None else folder / "map.toml")
    train, held = read[:logs], read[logs:]
    with threadpool_limits(limits=1):
        records = [record_from_log(log) for log in train]
        row = fitted(model, records) | {"metadata": _said(train[0].metadata)}
        if settings.diagnose:
            found = to_json(diagnose(train, held, model, seed=settings.seed))
            row |= {key: found[key] for key in ("verdict", "explained_to", "steps", "before", "after", "final")}
            row["depends_on"] = found["residual"]["depends_on"]
    return row


def fitted(model: Any, records: Any) -> dict[str, Any]:
    """The declared model fitted to one bench's records: free parameters (k) with their covariance (k, k).

    Windows are weighed by the noise that the fit leaves itself, a torque that lasts from one to the next with it; the
    covariance is what such weights say.
    """
    from fiohost.discover.logs.whitened import settle
    from fiohost.estimation.fit import fit_from_scratch

    plain = fit_from_scratch(model.on_axis(records[0].rotary), records, keep_start=model.given, windows=True)
    settled = settle(plain, records)
    found = settled.fit
    columns = np.vstack(found.jacobians)
    sizes = np.linalg.norm(columns, axis=0)
    ok, scale = sizes > 0.0, np.where(sizes > 0.0, sizes, 1.0)
    inverse = np.linalg.pinv((columns / scale).T @ (columns / scale), rcond=1e-12, hermitian=True)
    covariance = inverse / np.outer(scale, scale)
    return {
        "names": list(found.names),
        "values": [found.model.number(n) for n in found.names],
        "covariance": np.where(np.outer(ok, ok), covariance, np.nan).tolist(),
        "window_rms": settled.bare.rms,
        "unit": records[0].unit,
        "log_s": float(sum(r.seconds for r in records)),
    }


def _said(metadata: Mapping[str, str]) -> dict[str, str]:
    keys = ("serial", "serial_number", "start_time", "started", "date", "temperature_C", "supply_V", "type")
    return {key: metadata[key] for key in keys if metadata.get(key)}
