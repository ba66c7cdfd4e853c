"""The diagnosis as JSON, schema ``fiohost.diagnosis/1``."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from fiohost import __version__
from fiohost.discover.diagnose import Diagnosis, parameters, pooled
from fiohost.discover.logs.own_start import pooled as pooled_own
from fiohost.discover.settings import SETTINGS as SEARCH
from fiohost.estimation.counted import SETTINGS as COUNTS
from fiohost.estimation.intervals import Estimate
from fiohost.estimation.settings import SETTINGS as FIT
from fiohost.estimation.stamps import SETTINGS as STAMPS
from fiohost.judging.metrics import Errors, pool
from fiohost.judging.stage import Stage
from fiohost.judging.units import LOG_UNIT, in_metres
from fiohost.judging.verdict import Excess
from fiohost.noise.estimate import Ranged
from fiohost.noise.runs import FRICTIONS, LOAD_EFFECT
from fiohost.noise.settings import SETTINGS as NOISE


def _errors(errors: Errors | None) -> dict[str, Any] | None:
    return errors.to_json() if errors else None


def _parameters(diagnosis: Diagnosis, stage: Stage, only: str | None = None) -> dict[str, Any]:
    """Parameters with intervals."""
    known = parameters(diagnosis, stage)
    found: dict[str, Any] = {}
    for name, value in stage.fit.model.values.items():
        group, _, short = name.partition(".")
        if only is not None and group != only:
            continue
        key = short if only else name
        if isinstance(value, str):
            found[key] = {"value": value, "unit": "", "ci95": None, "identifiable": True, "at_bound": False}
        else:
            found[key] = known[name].to_json()
    return found


def _noise(found: Diagnosis) -> dict[str, Any] | None:
    """What is left beside counts: the sensor's noise, each log's own where they differ, and a random torque with its
    correlation time.
    """
    if found.noise is None or not found.noise.samples:
        return None
    noise, unit = found.noise.at(found.logged[0].sample_time_s), found.logged[0].unit
    torque = noise.torque_known

    def told(ranged: Ranged, unit: str, identifiable: bool) -> dict[str, Any]:
        return Estimate(ranged.value, unit, (ranged.low, ranged.high), identifiable, False).to_json()

    by_log = {name: times * noise.sensor.value for name, times in noise.louder.items()}
    return {
        "sensor_rms": told(noise.sensor, unit, True),
        **({"sensor_by_log": by_log} if by_log else {}),
        **({"sensor_of_angle": True} if noise.of_angle else {}),
        "torque_rms_pct": told(noise.torque_pct, "%", True),
        "torque_time_s": told(noise.torque_s, "s", torque),
    }


def _searched(found: Diagnosis) -> dict[str, Any]:
    """The training errors of the angle that was searched in the place of the speeds that add up to it."""
    return {
        "unit": found.train[0].unit,
        "before": _errors(pooled(found.declared.judgements)),
        "after": _errors(pooled(found.final.judgements)),
        "floor": _errors(pool([f.errors for f in found.final.floors])),
    }


def _run_to_run(found: Diagnosis) -> dict[str, Any]:
    """What differs from run to run, by the parameter that does: its standard deviation, and each run's own value."""
    runs, final = (found.noise.runs if found.noise else None), found.final.fit.model
    if runs is None or not runs.known:
        return {}
    friction = next((key for key in FRICTIONS if key in final.values), FRICTIONS[0])
    load = f"{LOAD_EFFECT}.level_pct"
    keys = ("linear.gain_deg_s_per_pct", friction, load)
    told: dict[str, Any] = {}
    for key, sd, ci95, i in zip(keys, runs.sd, runs.ci95, range(len(keys)), strict=True):
        if sd <= 0.0:
            continue
        value = final.number(key) if key in final.values else 0.0
        scale, unit = (1.0 if key == load else value), final.parameter(key).unit
        spread = Estimate(float(scale * sd), unit, (float(scale * ci95[0]), float(scale * ci95[1])), True, False)
        by_log = {name: float(value + scale * own[i]) for name, own in runs.by_run.items()}
        told[key] = {"sd": spread.to_json(), "sd_pct": None if key == load else 100.0 * float(sd), "by_log": by_log}
    return told


def _excess(above: Excess) -> dict[str, Any]:
    return {"log": above.record, "figure": above.figure, "value": above.value, "limit": above.limit}


def clean(value: Any) -> Any:
    """Plain JSON: no NaN or infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {k: clean(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [clean(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def to_json(found: Diagnosis) -> dict[str, Any]:
    """The whole diagnosis as a dictionary of schema ``fiohost.diagnosis/1``; of a linear axis in metres."""
    declared, final, unit = found.declared, found.final, found.logged[0].unit
    first, last = found.stages[0], found.stages[-1]
    logs: list[dict[str, Any]] = []
    own_starts = {
        r.name: own.to_json() if own else None for r, own in zip(found.holdout, found.own_starts, strict=True)
    }
    for role, records, before, after, floor in (
        ("train", found.logged, first.judgements, last.judgements, last.floors),
        ("holdout", found.holdout, found.before_holdout, found.after_holdout, found.floor_holdout),
    ):
        for record, b, a, f in zip(records, before, after, floor, strict=True):
            logs.append(
                {
                    "file": record.name,
                    **found.files.get(record.name, {}),
                    "role": role,
                    "before": b.errors.to_json(),
                    "after": a.errors.to_json(),
                    "floor": f.errors.to_json(),
                    "initial": {**a.start._asdict(), "angle": a.start.angle - record.ahead_deg},
                    **({"own_start": own_starts[record.name]} if role == "holdout" else {}),
                }
            )
    sources = {f.source for f in (*last.floors, *found.floor_holdout)}
    upcoming = found.outlook.next_experiment
    result = {
        "schema": "fiohost.diagnosis/1",
        "fiohost_version": __version__,
        "seconds": found.seconds,
        "output_unit": LOG_UNIT.get(unit, unit),
        **({"searched_as": _searched(found)} if found.logged_stages else {}),
        **found.preliminary.to_json(),
        "declared": {"model": declared.fit.model.expression, "parameters": _parameters(found, declared)},
        "verdict": found.verdict,
        "explained_to": found.explained_to,
        "explained_pct": found.explained_pct,
        "left_pct": final.left_pct,
        "tolerance_pct": found.tolerance_pct,
        "noise": _noise(found),
        "run_to_run": _run_to_run(found),
        "settings": {
            "noise": asdict(NOISE),
            "stamps": asdict(STAMPS),
            "counts": asdict(COUNTS),
            "search": asdict(SEARCH),
            "fit": asdict(FIT),
            "own_start": asdict(found.own_settings),
        },
        "clock": "logs one after the other" if found.one_clock else "as the logs say",
        "before": {"train": _errors(pooled(first.judgements)), "holdout": _errors(pooled(found.before_holdout))},
        "steps": [
            {
                "effect": step.effect,
                "parameters": _parameters(found, step.stage, step.effect),
                "evidence": step.evidence,
                "after": {"train": _errors(pooled(stage.judgements)), "holdout": _errors(pooled(held))},
                "indistinguishable_from": list(step.indistinguishable_from),
            }
            for step, stage, held in zip(found.steps, found.stages[1:], found.step_holdout, strict=True)
        ],
        "after": {"train": _errors(pooled(last.judgements)), "holdout": _errors(pooled(found.after_holdout))},
        "final": {"model": final.fit.model.expression, "parameters": _parameters(found, final)},
        "floor": {
            "train": _errors(pool([f.errors for f in last.floors])),
            "holdout": _errors(pool([f.errors for f in found.floor_holdout])),
            "from": "repeats" if "repeats" in sources else "noise" if found.noise_decided else "replicas",
            "replicas": SEARCH.floor.replicas,
        },
        "logs": logs,
        "candidates": [
            {"effect": c.effect, "score": max(c.score, 0.0), "rejected_because": c.rejected_because}
            for c in sorted(found.candidates, key=lambda c: c.score, reverse=True)
        ],
        "residual": {
            "white": found.white,
            "depends_on": found.depends_on,
            "empirical": found.outlook.empirical.to_json() if found.outlook.empirical else None,
            "tests": {
                **{f"missing_torque_{d.variable}": d.to_json() for d in found.residual},
                "above_floor": [_excess(e) for e in final.excesses if e.exceeded],
            },
        },
        "curves": [curve.to_json() for curve in found.curves],
        "unnamed": found.unnamed.to_json() if found.unnamed else None,
        "extrapolates": [{"log": name, "beyond": parts} for name, parts in found.extrapolates.items()],
        "own_start": pooled_own(found.own_starts),
        "holdout_not_followed": [_excess(e) for e in found.not_followed],
        "next_experiment": upcoming.to_json() if upcoming else None,
        "detection_limits": [limit.to_json() for limit in found.outlook.limits],
        "separation": upcoming.separation_json() if upcoming else None,
    }
    return clean(in_metres(result) if unit in LOG_UNIT else result)  # type: ignore[no-any-return]
