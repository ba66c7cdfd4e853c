"""Makes the pictures of the control lab's pages: ``python docs/tools/control_lab_pictures.py``."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from fiohost.bench.connect import connect
from fiohost.labs.characterise import characterise
from fiohost.labs.design_project import Task, design_project
from fiohost.labs.measure import measure
from fiohost.labs.open_loop_sine import open_loop_sine
from fiohost.labs.open_loop_step import open_loop_step
from fiohost.labs.play import Torque
from fiohost.labs.position_control import position_control
from fiohost.labs.session import Session
from fiohost.labs.speed_control import speed_control

FOLDER = Path(__file__).resolve().parent.parent / "images"
SEED = 1
DPI = 75


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with connect("sim", seed=SEED) as bench:
            results = [characterise(measure(bench, "A", 0.015, 9.0), 0.015, "sim")]
        with Session.open("sim:nxt_no_load", "no_load", folder, seed=SEED) as session:
            results += [
                open_loop_step(session, torque=Torque(-0.05, 2.0)),
                open_loop_sine(session),
                speed_control(session, torque=Torque(-0.05, 1.0)),
                position_control(session),
            ]
        with Session.open("sim:nxt_arm_measured", "arm_measured", folder, seed=SEED) as session:
            results.append(design_project(session, Task(), animate=True))
            shutil.copy(folder / "design_project.gif", FOLDER / "lab_design_project.gif")
        for result in results:
            for picture, draw in result.figures.items():
                draw().savefig(FOLDER / f"lab_{picture}.png", dpi=DPI)


if __name__ == "__main__":
    main()
