"""``fiohost lab manual``: manual control, scripted."""

from __future__ import annotations

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_seed, target_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress


@click.command()
@target_options
@result_options
def manual(target: str, seed: str | None, report: str | None, json_to: str | None) -> None:
    """Duty up and down in steps, both directions: speed against duty, dead zone, friction, brake and standby.

    What a hand on the slider of `fiohost panel` sees, as tables. On a real board it takes some minutes.

    \b
    Example:
      fiohost lab manual
      fiohost lab manual --target sim:nxt_fast_decay --report fast
    """
    out = output_for(json_to)
    folder = report_folder(report)

    from fiohost.bench.connect import connect
    from fiohost.labs.manual import manual_control

    with progress() as doing, connect(target, seed=parse_seed(seed)) as bench:
        doing(f"a staircase of duties, slow ramps, brake and standby, on {target}")
        result = manual_control(bench, folder)
    present(result, out, folder)
