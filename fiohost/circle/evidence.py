"""From log files to a diagnosis: roles are checked before anything is fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from fiohost.advice.outlook import look_ahead
from fiohost.bench.log import IMPORTED, Log
from fiohost.checks.said import said_by
from fiohost.circle.menu import menu
from fiohost.discover.diagnose import Diagnosis, diagnose_records
from fiohost.discover.logs.own_start import SETTINGS as OWN
from fiohost.errors import ConfigError, DataError
from fiohost.estimation.record import Record, record_from_log
from fiohost.importing.found import Answers
from fiohost.motor.model import Model

Source = str | Path | Log
TableIs = str | Path | Answers | None  # what foreign tables are: a map, answers, or found
LONGEST_OWN_S = 3600.0


def read_logs(sources: Sequence[Source], table_map: TableIs = None) -> list[Log]:
    """Read logs; foreign tables by a map, or by the one that is found for them with the answers to what nobody can
    know. Tables of one bench are read at once, as they are understood together. Raises FiohostError.
    """
    from fiohost.importing.automatic import read_any

    if table_map is None or isinstance(table_map, Answers):
        return read_any(sources, table_map)
    from fiohost.importing.convert import log_from_table
    from fiohost.importing.map import TableMap

    mapping = TableMap.load(table_map)
    return [s if isinstance(s, Log) else log_from_table(Path(s), mapping) for s in sources]


def check_roles(train: Sequence[Log], holdout: Sequence[Log]) -> None:
    """Refuse a log in both roles (by its contents), and a file that is given twice. Raises DataError."""
    fitted = {log.sha256: log.path for log in train}
    for log in holdout:
        if log.sha256 in fitted:
            raise DataError(
                f"{log.path} is in both roles: its contents are those of the training log {fitted[log.sha256]}; "
                "a held-out log must not be fitted"
            )
    paths = [log.path.resolve() for log in (*train, *holdout) if log.path.exists()]
    for path in paths:
        if paths.count(path) > 1:
            raise DataError(f"{path} is given twice; give each log once")


def unique_names(logs: Sequence[Log]) -> list[str]:
    """File names, with the folder where that tells them apart, else with a number."""
    names = [log.path.name for log in logs]
    names = [str(log.path) if names.count(name) > 1 else name for log, name in zip(logs, names, strict=True)]
    return [f"{name} {names[:i].count(name) + 1}" if names.count(name) > 1 else name for i, name in enumerate(names)]


def diagnose(
    logs: Sequence[Source],
    holdout: Sequence[Source] = (),
    model: str | Model = "linear",
    *,
    table_map: TableIs = None,
    library: Sequence[str] | None = None,
    seed: int = 0,
    limits: bool = False,
    tolerance_pct: float = 0.0,
    own_seconds: float = OWN.seconds,
    say: Callable[[str], None] = lambda text: None,
    announce: Callable[[Sequence[Log], Sequence[Log]], None] = lambda train, held: None,
) -> Diagnosis:
    """Name what a declared model lacks, from training logs; held-out logs only report.

    ``model`` is an expression such as ``linear+coulomb_friction``, a model file or a Model; ``announce`` is told the
    logs and their roles before anything is fitted, ``say`` hears of progress. ``limits`` also asks how small effects
    would have been seen where some were found. What is left is as good as nothing where windows of 1 s err by less
    than ``tolerance_pct`` of the motion in them. Of a held-out log the first ``own_seconds`` say what is its own, 0
    that nothing is. Raises FiohostError.
    """
    if not 0.0 <= own_seconds <= LONGEST_OWN_S:
        raise ConfigError(f"own_seconds = {own_seconds:g} is not within 0 to {LONGEST_OWN_S:g} s")
    declared = model if isinstance(model, Model) else Model.parse(str(model))
    read = read_logs([*logs, *holdout], table_map)
    train, held = read[: len(logs)], read[len(logs) :]
    check_roles(train, held)
    announce(train, held)
    names = unique_names([*train, *held])
    records: list[Record] = [record_from_log(log, name) for log, name in zip([*train, *held], names, strict=True)]
    files = {
        name: {"sha256": log.sha256, "path": str(log.path)} for log, name in zip([*train, *held], names, strict=True)
    }
    found = diagnose_records(
        records[: len(train)],
        records[len(train) :],
        declared,
        library=library,
        from_file=declared.given,
        seed=seed,
        tolerance_pct=tolerance_pct,
        own=replace(OWN, seconds=own_seconds),
        say=say,
        files=files,
        said={name: said_by(log) for log, name in zip([*train, *held], names, strict=True)},
    )
    another = all(log.metadata.get("target", IMPORTED) == IMPORTED for log in train)
    return look_ahead(found, menu(), limits=limits, library=library, say=say, another_bench=another)
