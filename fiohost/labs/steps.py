"""The text's numbered steps as a checklist: for each the command that does it, and the answer by this very run."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from fiohost.errors import ConfigError
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.labs.session import Session

LAST = 25
# Steps of the control lab appendix, section D-4: the command that does each
COMMANDS = {
    1: "open-loop-step --volts 1,3,-2",
    2: "open-loop-step",
    3: "open-loop-step",
    4: "open-loop-step --volts 1 --disturbance -0.05",
    5: "open-loop-step --volts 1",
    6: "open-loop-step --volts 1",
    7: "open-loop-step --volts 1,3,-2 --target T",
    8: "open-loop-step --target T",
    9: "open-loop-sine --frequencies 0.5,1,2,5,10",
    10: "open-loop-sine --large 10",
    11: "speed-control --gains 0.1,0.5,1 --refs 12,-10,15",
    12: "speed-control --gear-load 0.5",
    13: "speed-control --gains 0.1,0.5,1",
    14: "speed-control --gains 0.1",
    15: "speed-control --refs 12,-10,15 --target T",
    16: "position-control --gains 1.5,2,5 --step 160",
    17: "position-control --disturbance -0.1",
    18: "position-control --disturbance -0.1 --integrals 1,3,6 --pid 3,6,0.1",
    19: "position-control --integrals 1,3,6",
    20: "position-control --saturation none",
    21: "position-control --overshoot 30 --rise 0.1",
    22: "position-control --gains 1.5,2,5",
    23: "position-control --gains 1.5,2,5 --target T",
    24: "position-control --gains 5 --target T",
    25: "position-control --overshoot 30 --rise 0.1 --target T",
}


def steps(session: Session, wanted: Sequence[int] = ()) -> LabResult:
    """Do the experiments that the wanted steps (all, where none are named) belong to, and gather their answers."""
    from fiohost.labs.open_loop_sine import FREQUENCIES, open_loop_sine
    from fiohost.labs.open_loop_step import open_loop_step
    from fiohost.labs.play import Torque
    from fiohost.labs.position_control import position_control
    from fiohost.labs.speed_control import speed_control

    wanted = list(wanted) or list(COMMANDS)
    for step in wanted:
        if step not in COMMANDS:
            raise ConfigError(f"there is no step {step}: the text has 1 to {LAST}")
    experiments: dict[str, Callable[[], LabResult]] = {
        "open-loop-step": lambda: open_loop_step(session, torque=Torque(-0.05, 2.0)),
        "open-loop-sine": lambda: open_loop_sine(session, FREQUENCIES),
        "speed-control": lambda: speed_control(session),
        "position-control": lambda: position_control(session),
    }
    found: dict[int, Answer] = {}
    results = []
    for name, do in experiments.items():
        if any(COMMANDS[step].split()[0] == name for step in wanted):
            results.append(do())
            for answer in results[-1].answers:
                number = re.match(r"Step (\d+)\.", answer.question)
                if number:
                    found[int(number[1])] = answer
    rows = [[step, f"fiohost lab {COMMANDS[step]}", "answered" if step in found else "no answer"] for step in wanted]
    return LabResult(
        name="steps",
        title="The control lab's steps 1 to 25",
        target=session.target,
        tables=(Table("Checklist", ("step", "command", "this run"), rows, (0, 1)),),
        answers=tuple(found[step] for step in wanted if step in found),
        notes=tuple(dict.fromkeys(note for result in results for note in result.notes)),
        values={"answered": [step for step in wanted if step in found]},
        figures={name: draw for result in results for name, draw in result.figures.items()},
        files=dict(session.logs),
    )
