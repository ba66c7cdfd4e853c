"""How small an effect logs would show, without looking for any: what ``fiohost effects --limits`` says."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost.advice.limit import Limit, Measured
from fiohost.advice.limits import detection_limits
from fiohost.circle.evidence import Source, TableIs, check_roles, read_logs, unique_names
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.errors import DataError
from fiohost.estimation.bench import pwm_of, with_bench
from fiohost.estimation.record import record_from_log
from fiohost.judging.metrics import pool
from fiohost.motor.effect import effects
from fiohost.motor.model import Model


def smallest_visible(
    logs: Sequence[Source],
    model: str | Model,
    *,
    table_map: TableIs = None,
    library: Sequence[str] | None = None,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> Measured:
    """Fit a model to logs and find the smallest size of every effect of the library that they would have shown.

    Every effect has at least one limit, without a size where none can be told. Raises FiohostError, and DataError where
    the model leaves something unexplained, which would hide what else may be there.
    """
    declared = model if isinstance(model, Model) else Model.parse(str(model))
    sources = read_logs(logs, table_map)
    check_roles(sources, ())
    records = with_bench([record_from_log(log, name) for log, name in zip(sources, unique_names(sources), strict=True)])
    declared = declared.on_axis(records[0].rotary).with_pwm(pwm_of(records))
    seconds = sum(r.seconds for r in records)
    with threadpool_limits(limits=1, user_api="blas"):
        say(f"fitting {declared.expression} to {len(records)} logs, {seconds:.0f} s")
        runs = WholeRuns(records, np.random.default_rng(seed))
        stage = runs.stage(runs.finished(runs.declared(declared, declared.given)))
        if not stage.follows:
            raise DataError(
                f"{declared.expression} leaves something unexplained in these logs, which hides how small an effect "
                "would show; fiohost diagnose names it, --save-model writes the model to give here"
            )
        say("finding how small an effect would have been seen")
        found = detection_limits(stage, records, library)
    floor = pool([f.errors for f in stage.floors])
    named = {x.effect for x in found}
    rest = [n for n in (effects() if library is None else library) if n not in named]
    limits = sorted([*found, *(_without(n, declared) for n in rest)], key=lambda x: x.effect)
    experiments = tuple(log.metadata.get("experiment", "") for log in sources)
    names = {log.metadata.get("target", "") for log in sources}
    return Measured(
        names.pop() if len(names) == 1 else "",
        declared.expression,
        experiments,
        seconds,
        floor.window_rms if floor else 0.0,
        tuple(limits),
    )


def _without(name: str, model: Model) -> Limit:
    """An effect that was not tried, with the reason."""
    item = effects()[name]
    first = item.parameters[0]
    if name == "linear" or name in model.effects:
        reason = "part of the model: fitted whatever its size"
    elif item.equivalents:
        reason = f"the same in every log as {' and '.join(item.equivalents)}"
    elif item.points or not (item.trials or item.trials_for):
        reason = "not tried at sizes of its own: it is read from what is left over angle or time"
    else:
        reason = "not met in these logs"
    return Limit(name, first.name, first.unit, None, first.neutral, reason=reason)
