"""``fiohost identify``: the motor's K and tau, and the loop's zeta and wn, from logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.options import PATH, expanded, parse_number
from fiohost.cli.output import Output, json_option, output_for
from fiohost.cli.tables import Told, table_options
from fiohost.files import claim, shown

if TYPE_CHECKING:
    from fiohost.estimation.logs import Identification

MOST_ROWS = 200_000  # of a log, some 17 minutes at 5 ms: two parameters need no more, and more takes long
STRETCHES = 10  # of a longer log, each with many steps in it and all of its time among them
NAMES = {
    "gain_deg_s_per_pct": "K",
    "tau_s": "tau",
    "zeta": "zeta",
    "omega_n_rad_s": "omega_n",
    "static_gain": "static gain",
}


@click.command()
@click.argument("logs", nargs=-1, required=True, type=PATH, metavar="LOG...")
@click.option("--method", default="pem", show_default=True, metavar="step|pem", help="Step figures, or a fit.")
@click.option(
    "--from", "fitted", metavar="reference|duty",
    help="What pem fits from.  [default: the reference of a closed loop, else the duty]",
)  # fmt: skip
@click.option("--kp", metavar="K", help="Gain of the P controller in percent per degree.  [default: as the logs say]")
@table_options("The logs are foreign tables; MAP says how to read them.")
@click.option("--save-model", type=PATH, metavar="FILE", help="Write the motor as a model file.")
@click.option("--plot", "plot_to", type=PATH, metavar="F", help="Picture of the first log.")
@json_option
def identify(
    logs: Sequence[Path],
    method: str,
    fitted: str | None,
    kp: str | None,
    told: Told,
    save_model: Path | None,
    plot_to: Path | None,
    json_to: str | None,
) -> None:
    """Find K and tau of the motor, and zeta and omega_n of the loop with a P controller around it.

    step: overshoot and peak time of every step of a square wave, averaged (Eq. 2.7 of the INC451 lab text).
    pem: a fit of the loop's second-order form from reference to angle; from the duty, of K / (s (tau s + 1)) on the
    commands, to the angle or, of logs of speed, to the speed. The intervals hold 95 %; what the form lacks, such as
    friction, is in none of them.

    \b
    Examples:
      fiohost identify run.csv --method step
      fiohost identify run.csv --plot fit.png --save-model motor.toml
      fiohost identify staircase.csv multisine.csv --from duty
    """
    out = output_for(json_to)
    for output in (save_model, plot_to):
        if output is not None:
            claim(output)
    gain = None if kp is None else parse_number("--kp", kp, 1e-6, 1e6, "percent per degree")

    from fiohost.circle.evidence import read_logs
    from fiohost.estimation.logs import identify as run
    from fiohost.importing.automatic import understood

    whole = read_logs(expanded(logs, "LOG"), told.how)
    rows = {str(log.path): len(log) for log in whole}
    read = [stretch for log in whole for stretch in log.stretches(MOST_ROWS, STRETCHES)]
    del whole
    found = run(read, method, fitted=fitted, kp_pct_per_deg=gain)
    _say(out, found)
    for log in {log.path: log for log in read}.values():
        if understood(log):
            out(f"note: {shown(log.path)}: {understood(log)}")
    dropped = {str(log.path): list(log.dropped) for log in read if log.dropped}
    for name, notes in dropped.items():
        out(f"note: {shown(name)}: left out or doubtful: {'; '.join(notes)}")
    if save_model is not None:
        found.model.write(save_model, f"identified by {found.method} from {', '.join(str(log) for log in logs)}")
        out(f"model written to {save_model}")
    if plot_to is not None:
        from fiohost.report.identification import plot_identification
        from fiohost.report.pictures import save_figure

        label = f"{found.method}: {motor_text(found)}"
        save_figure(
            plot_identification(f"Identification from {found.curves[0].name}", {label: found.curves[0]}), plot_to
        )
        out(f"plot: {plot_to}")
    fitted_rows = {name: sum(len(log) for log in read if str(log.path) == name) for name in rows}
    used = {name: {"rows": rows[name], "rows_fitted": fitted_rows[name]} for name in rows}
    out.json(found.to_json() | {"plot": plot_to, "model_file": save_model, "dropped": dropped, "used": used})


def motor_text(found: Identification) -> str:
    return f"K = {found.value('gain_deg_s_per_pct'):.3g} deg/s per %, tau = {found.value('tau_s'):.3g} s"


def _say(out: Output, found: Identification) -> None:
    output = "angle" if found.output_unit == "deg" else "speed"
    source = {"step": "overshoot and peak time of the steps", "reference": "from reference to angle"}
    what = source["step"] if found.method == "step" else source.get(found.fitted, f"from duty to {output}")
    out(f"{found.method}: {what}, kp = {found.kp_pct_per_deg:g} %/deg")
    out("parameter        value         95 % interval       unit")
    for name, estimate in found.parameters.items():
        low, high = estimate.ci95
        spread = f"   spread {found.spread[name]:.3g}" if name in found.spread else ""
        out(f"{NAMES[name]:<12} {estimate.value:9.4g}  {low:9.4g} .. {high:<9.4g}  {estimate.unit or '-'}{spread}")
    if found.steps:
        out("\nstep at   from -> to (deg)   overshoot   rise      peak      settling 2 %   error")
        for step in found.steps:
            f = step.figures
            out(
                f"{step.at_s:6.2f} s  {step.from_deg:7.1f} -> {step.to_deg:<7.1f}  {f.overshoot_pct:7.2f} %  "
                f"{f.rise_s:6.3f} s  {f.peak_s:6.3f} s  {f.settling_2_s:6.3f} s      {f.steady_state_error:6.2f} deg"
            )
        out()
    out(f"simulated against measured: {found.fit_pct:.1f} % fit, {found.rms:.3g} {found.output_unit} rms")
    for note in found.notes:
        out(f"note: {note}")
