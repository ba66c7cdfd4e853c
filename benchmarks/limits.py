"""Measures how small each effect may be and still show: the shipped suite of experiments on the default plant.

    python benchmarks/limits.py          writes configs/limits/default_suite.toml; then docs/tools/effects_page.py

An effect's limit is the size at which a figure of a log passes what counts alone would leave there (docs/effects.md).
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from fiohost import __version__
from fiohost.advice.limit import SCHEMA, SHIPPED, Limit, Measured
from fiohost.bench.connect import connect
from fiohost.circle.detection import smallest_visible
from fiohost.circle.plan import log_names, suite
from fiohost.errors import DataError
from fiohost.motor.effect import Value

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "configs" / "limits" / f"{SHIPPED}.toml"
# How the shaft starts. By chance counts may lie outside what replicas of them do; then with the next.
SEEDS = range(5)
PLANT = "default"
# What the plant has, by the key of its file. Each is measured on the same plant without it.
HAS = {"coulomb_friction": "coulomb_Nm", "armature_inductance": "L_H"}

HEAD = """\
# The smallest size of each effect that the shipped suite of experiments shows on the default simulated plant.
# Written by benchmarks/limits.py, fiohost {version}; not to be edited. Counts are half a degree, and the model is
# what the plant is; its own effects are measured on the same plant without them. A motor that does not repeat itself as
# well as a simulated one shows less.
"""


def quoted(value: Value) -> str:
    return f'"{value}"' if isinstance(value, str) else f"{value:.4g}"


def row(limit: Limit) -> str:
    lines = ["[[limit]]", f'effect = "{limit.effect}"', f'parameter = "{limit.parameter}"']
    if limit.neutral is not None:
        lines.append(f"neutral = {limit.neutral:g}")
    if limit.value is None:
        lines.append(f'reason = "{limit.reason}"')
    else:
        vanishes = limit.neutral or 0.0
        lines.append(f"smallest_visible = {vanishes + float(f'{limit.value - vanishes:.3g}'):.9g}")
        if limit.at:
            lines.append(f"at = {{ {', '.join(f'{k} = {quoted(v)}' for k, v in limit.at.items())} }}")
        lines += [f'log = "{limit.log}"', f'figure = "{limit.figure}"']
    return "\n".join(lines)


def text(found: Measured) -> str:
    names = ", ".join(f'"{e}"' for e in found.experiments)
    top = [
        f'schema = "{SCHEMA}"',
        f'plant = "{PLANT}"',
        f'model = "{found.model}"',
        f"experiments = [{names}]",
        f"seconds = {found.seconds:.1f}",
        f"window_floor_deg = {found.window_floor_deg:.4f}",
    ]
    rows = [row(limit) for limit in found.limits]
    return "\n\n".join([HEAD.format(version=__version__) + "\n".join(top), *rows]) + "\n"


def measured(without: str | None = None) -> Measured:
    """Limits beside all that the plant has, or of one thing that it has, on the plant without it."""
    lines = (ROOT / "configs" / "plants" / f"{PLANT}.toml").read_text(encoding="utf-8").splitlines()
    model = "+".join(("linear", *(name for name in HAS if name != without)))
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as name:
            file = Path(name) / f"{PLANT}.toml"
            file.write_text("\n".join(x for x in lines if without is None or not x.startswith(HAS[without])))
            with connect(f"sim:{file}", seed=seed) as bench:
                planned = suite()
                logs = [bench.run(e, Path(name) / n) for e, n in zip(planned, log_names(planned), strict=True)]
            try:
                return smallest_visible(logs, model, library=[without] if without else None, say=print)
            except DataError as exc:
                print(exc)
    raise SystemExit(f"{model} is not what the plant is")


def main() -> None:
    found = measured()
    own = [limit for effect in HAS for limit in measured(effect).limits]
    limits = sorted([*(x for x in found.limits if x.effect not in HAS), *own], key=lambda x: x.effect)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(text(replace(found, limits=tuple(limits))), encoding="utf-8")
    print(f"{OUT}: {len(limits)} limits of {len({x.effect for x in limits})} effects")


if __name__ == "__main__":
    main()
