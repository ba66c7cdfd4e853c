"""A design as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fiohost.control.design import Design


def lines_of(found: Design) -> list[str]:
    """The gains, a table of the responses, and what of the specification is met."""
    asked = found.asked
    lines = [f"{found.settings.kind.upper()} for {found.model.expression}"]
    for name, value in found.settings.describe_numbers().items():
        lines.append(f"  {name:<17} {value if isinstance(value, str) else f'{value:.4g}'}")
    lines += ["", "step            overshoot   settling   error      rise"]
    for one in found.found:
        if one.step_deg > 0.0:
            figures = f"{one.overshoot_pct:6.2f} %   {one.settling_s:6.3f} s   {one.error_deg:5.2f} deg"
            lines.append(f"{one.step_deg:8.1f} deg    {figures}  {one.rise_s:6.3f} s")
    lines.append(f"asked for     < {asked.overshoot_pct:6.2f} % < {asked.settling_s:6.3f} s < {asked.sse_deg:5.2f} deg")
    off = {name: max(getattr(one, name) for one in found.off) for name in ("overshoot_pct", "settling_s", "error_deg")}
    lines.append(
        f"model off       {off['overshoot_pct']:6.2f} %   {off['settling_s']:6.3f} s   {off['error_deg']:5.2f} deg   "
        "(worst: gain and lag off by 10 %, friction by 20 %, a tick more of delay)"
    )
    if found.feasible:
        robust = ", and on all models that are off" if found.robust else ", but not on all models that are off"
        lines.append(f"the specification is met on the model{robust}")
    else:
        lines += _not_feasible(found)
    return lines + [f"note: {note}" for note in found.notes]


def _not_feasible(found: Design) -> list[str]:
    """That it cannot be met, and what can."""
    lines = [
        f"NOT FEASIBLE: no {found.settings.kind} controller found meets the specification; nearest that can be met:"
    ]
    if not found.nearest:
        lines.append("  none: with no gains that were tried does the loop come to rest")
    for near in found.nearest:
        spec, gains = near.asked, near.settings.describe_numbers()
        kept = ", ".join(f"{name} {value:.4g}" for name, value in gains.items() if name[0] == "k")
        lines += [
            f" overshoot < {spec.overshoot_pct:g} %, settling < {spec.settling_s:g} s, error < {spec.sse_deg:g} deg",
            f"    ({' and '.join(near.gives_way)} give way; {kept})",
        ]
    return lines
