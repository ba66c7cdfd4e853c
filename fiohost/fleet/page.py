"""The page of a fleet: what occurs how often, who stands apart, what drifts; nothing in it is loaded from anywhere."""

from __future__ import annotations

from pathlib import Path

import jinja2
import numpy as np
from matplotlib.figure import Figure

from fiohost import __version__
from fiohost.files import write_output
from fiohost.fleet.summary import LEFT, Fleet
from fiohost.fleet.together import APART_Z
from fiohost.report.plots import as_svg

MOST_NAMED = 50

TEMPLATE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Fleet</title><style>
body { font: 16px/1.45 system-ui, sans-serif; max-width: 64rem; margin: 1.5rem auto; padding: 0 1rem; color: #111; }
table { border-collapse: collapse; margin: .5rem 0 1.2rem; } th, td { border: 1px solid #bbb; padding: .25rem .6rem; }
th { background: #f2f2f2; text-align: left; } svg { max-width: 100%; height: auto; } .n { text-align: right; }
</style></head><body>
<h1>{{ benches }} benches</h1>
<p>{% for name, count in verdicts %}{{ name }}: {{ count }}{{ ", " if not loop.last }}{% endfor %}.
{{ apart|length }} stand{{ "s" if apart|length == 1 }} apart from the others{% if failed %}, {{ failed|length }} could not be judged{% endif %}.</p>
<h2>Effects found</h2>
{% if effects %}<table><tr><th>effect</th><th>benches</th><th>share</th></tr>
{% for name, count in effects %}<tr><td>{{ name }}</td><td class="n">{{ count }}</td><td class="n">{{ "%.1f" % (100 * count / benches) }} %</td></tr>
{% endfor %}</table>{% elif looked %}<p>None.</p>{% else %}<p>Not looked for: the benches were fitted only.</p>{% endif %}
<h2>Motors that stand apart</h2>
{% if apart %}<table><tr><th>bench</th><th>most in</th><th>robust z</th></tr>
{% for name, what, z in apart[:most] %}<tr><td>{{ name }}</td><td>{{ what }}</td><td class="n">{{ "%+.1f" % z }}</td></tr>
{% endfor %}</table>{% if apart|length > most %}<p>and {{ apart|length - most }} more; the table has all.</p>{% endif %}
{% else %}<p>None beyond {{ limit }} robust standard deviations.</p>{% endif %}
<div>{{ scatter }}</div>
<h2>What the motors have in common</h2>
{% for type, parameters in types %}<h3>{{ type }}</h3><table><tr><th>parameter</th><th>median</th><th>scatter over motors</th><th>motors</th></tr>
{% for name, p in parameters %}<tr><td>{{ name }}</td><td class="n">{{ "%.4g" % p.median }}</td><td class="n">{{ "%.2g" % p.sd }}</td><td class="n">{{ p.motors }}</td></tr>
{% endfor %}</table>{% else %}<p>Too few motors to say.</p>{% endfor %}
<h2>Drift{% if order %} over {{ order }}{% endif %}</h2>
{% if not order %}<p>No serial number or time is known of the benches.</p>
{% elif trends %}<table><tr><th>parameter</th><th>slope</th><th>95 %</th></tr>
{% for name, t in trends %}<tr><td>{{ name }}</td><td class="n">{{ "%.3g" % t.slope }}</td><td>{{ "%.3g" % t.low }} to {{ "%.3g" % t.high }}</td></tr>
{% endfor %}</table>{% else %}<p>None.</p>{% endif %}
{% if order %}<div>{{ over_order }}</div>{% endif %}
{% if failed %}<h2>Not judged</h2><table><tr><th>bench</th><th>why</th></tr>
{% for name, why in failed[:most] %}<tr><td>{{ name }}</td><td>{{ why }}</td></tr>
{% endfor %}</table>{% endif %}
<p>Made by fiohost {{ version }}.</p></body></html>
"""  # noqa: E501


def write_fleet_page(fleet: Fleet, path: Path) -> None:
    """Write the page, whole or not at all. Raises FiohostError."""
    told = fleet.to_json()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    html = environment.from_string(TEMPLATE).render(
        benches=len(fleet.rows),
        verdicts=list(told["verdicts"].items()),
        effects=list(fleet.effects.items()),
        looked=any("steps" in row for row in fleet.rows),
        apart=fleet.apart,
        failed=fleet.failed,
        types=[(name, list(p.items())) for name, p in told["types"].items()],
        trends=list(fleet.trends.items()),
        order=fleet.order_name,
        most=MOST_NAMED,
        limit=APART_Z,
        scatter=_svg(_values(fleet, np.arange(len(fleet.rows), dtype=np.float64), "bench")),
        over_order=_svg(_values(fleet, fleet.order, fleet.order_name)) if fleet.order_name else "",
        version=__version__,
    )
    write_output(path, html)


def _svg(figure: Figure) -> str:
    from markupsafe import Markup

    return Markup(as_svg(figure))


def _values(fleet: Fleet, across: np.ndarray, label: str) -> Figure:
    """Each parameter over the benches, those that stand apart in red."""
    names = (*fleet.names, LEFT)
    figure = Figure(figsize=(9.0, 1.7 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    far = np.array([np.isfinite(z).any() and float(np.nanmax(np.abs(z))) > APART_Z for z in fleet.z], dtype=bool)
    for k, (axis, name) in enumerate(zip(axes, names, strict=True)):
        values = np.array([_of(row, k, fleet.names) for row in fleet.rows])
        axis.plot(across[~far], values[~far], ".", color="0.4", markersize=4)
        axis.plot(across[far], values[far], "o", color="tab:red", markersize=4)
        axis.set_ylabel(name.replace(".", "\n"), fontsize=7)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel(label)
    return figure


def _of(row: object, k: int, names: tuple[str, ...]) -> float:
    assert isinstance(row, dict)
    if row.get("error") or tuple(row.get("names", ())) != names:
        return float("nan")
    return float(row["values"][k]) if k < len(names) else float(row[LEFT])
